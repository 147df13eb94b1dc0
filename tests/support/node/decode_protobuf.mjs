// Decodes the protobuf messages of an MCAP file with protobufjs, as Foxglove and Lichtblick do.
//
//     node decode_protobuf.mjs FILE
//
// Prints one JSON object a line for each message: its topic and its fields, 64-bit integers and bytes as text. A topic that
// the viewers would not show is named on stderr, and the exit code is 1.

import { open } from "node:fs/promises";

import { McapIndexedReader } from "@mcap/core";
import protobufjs from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";

import { loadDecompressHandlers, Ranges } from "./mcap_file.mjs";

/** Refuse what the viewers' translation of types refuses. */
function checkType(type, seen = new Set()) {
  if (seen.has(type)) {
    return;
  }
  seen.add(type);
  for (const field of type.fieldsArray) {
    if (field.resolvedType instanceof protobufjs.Type) {
      checkType(field.resolvedType, seen);
    } else if (field.type === "bytes" && field.repeated) {
      throw new Error(`field ${field.name}: viewers refuse repeated bytes`);
    }
  }
}

function decoderOf(schema) {
  const root = protobufjs.Root.fromDescriptor(descriptor.FileDescriptorSet.decode(schema.data));
  root.resolveAll();
  const type = root.lookupType(schema.name);
  checkType(type);
  return (data) => type.toObject(type.decode(data), { defaults: true, longs: String, bytes: String });
}

const handle = await open(process.argv[2]);
const reader = await McapIndexedReader.Initialize({
  readable: new Ranges(handle),
  decompressHandlers: await loadDecompressHandlers(),
});
const decoders = new Map();
for (const channel of reader.channelsById.values()) {
  if (channel.messageEncoding === "protobuf") {
    try {
      decoders.set(channel.id, decoderOf(reader.schemasById.get(channel.schemaId)));
    } catch (error) {
      console.error(`${channel.topic}: ${error.message}`);
      process.exitCode = 1;
    }
  }
}
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const decode = decoders.get(message.channelId);
  if (decode != undefined) {
    const { topic } = reader.channelsById.get(message.channelId);
    console.log(JSON.stringify({ topic, fields: decode(message.data) }));
  }
}
await handle.close();
