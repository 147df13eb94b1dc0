// Reads rosbag2 MCAP files and ROS 1 bags as the viewers do: with the definitions that they carry, every CRC checked.
//
//     node read_bags.mjs FILE...
//
// Prints one JSON object a line for each file: of each topic the type, the number of messages and the first one. A file
// that cannot be read is named on stderr, and the exit code is 1.

import { createRequire } from "node:module";
import { readFile } from "node:fs/promises";

import { McapIndexedReader } from "@mcap/core";

// These packages are CommonJS: their ES modules lack the file extensions that node asks for.
const require = createRequire(import.meta.url);
const { Bag } = require("@foxglove/rosbag");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg-serialization");
const { MessageReader: MessageReader2 } = require("@foxglove/rosmsg2-serialization");
const bz2 = require("@foxglove/wasm-bz2");
const lz4 = require("@foxglove/wasm-lz4");
const zstd = require("@foxglove/wasm-zstd");

/** Numbers of 64 bits as text, typed arrays as arrays, what JSON cannot say as its name. */
function plain(key, value) {
  if (typeof value === "bigint") {
    return value.toString();
  }
  return ArrayBuffer.isView(value) ? Array.from(value) : value;
}

function add(topics, topic, type, message) {
  const known = (topics[topic] ??= { type, count: 0, first: message });
  known.count += 1;
}

async function readMcap(path, decompressHandlers) {
  const data = new Uint8Array(await readFile(path));
  const readable = {
    size: async () => BigInt(data.length),
    read: async (offset, length) => data.slice(Number(offset), Number(offset + length)),
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const decoders = new Map();
  const topics = {};
  let last = 0n;
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    if (message.logTime < last) {
      throw new Error(`message at ${message.logTime} ns comes behind one at ${last} ns`);
    }
    last = message.logTime;
    const channel = reader.channelsById.get(message.channelId);
    const schema = reader.schemasById.get(channel.schemaId);
    if (!decoders.has(schema.id)) {
      decoders.set(schema.id, new MessageReader2(parse(new TextDecoder().decode(schema.data), { ros2: true })));
    }
    add(topics, channel.topic, schema.name, decoders.get(schema.id).readMessage(message.data));
  }
  return { profile: reader.header.profile, topics };
}

async function readBag(path, decompress) {
  const data = new Uint8Array(await readFile(path));
  const file = { size: () => data.length, read: async (offset, length) => data.slice(offset, offset + length) };
  const bag = new Bag(file, { decompress });
  await bag.open();
  const decoders = new Map();
  const types = new Map();
  for (const connection of bag.connections.values()) {
    decoders.set(connection.conn, new MessageReader(parse(connection.messageDefinition)));
    types.set(connection.conn, connection.type);
  }
  const topics = {};
  for await (const event of bag.messageIterator()) {
    const decoder = decoders.get(event.connectionId);
    add(topics, event.topic, types.get(event.connectionId), decoder.readMessage(event.data));
  }
  return { topics };
}

await Promise.all([lz4.isLoaded, zstd.isLoaded]);
const unzip = await bz2.default.init();
const handlers = {
  lz4: (data, size) => new Uint8Array(lz4(data, Number(size))),
  zstd: (data, size) => new Uint8Array(zstd.decompress(data, Number(size))),
  bz2: (data, size) => unzip.decompress(data, Number(size), { small: false }),
};
for (const path of process.argv.slice(2)) {
  try {
    const found = path.endsWith(".bag") ? await readBag(path, handlers) : await readMcap(path, handlers);
    console.log(JSON.stringify({ path, ...found }, plain));
  } catch (error) {
    console.error(`${path}: ${error.stack}`);
    process.exitCode = 1;
  }
}
