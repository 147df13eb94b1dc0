// Reads MCAP files as the viewers do, through the index and as a stream, with every CRC checked.
//
//     node read_mcap.mjs FILE...
//
// Prints one JSON object a line for each file that reads well. A file that does not is named on stderr, and the exit code is 1.

import { open } from "node:fs/promises";

import { McapIndexedReader, McapStreamReader } from "@mcap/core";

import { loadDecompressHandlers, Ranges } from "./mcap_file.mjs";

const STREAM_PIECE_BYTES = 64 * 1024;

/** The row in a JSON message; null for other encodings. */
function decode(message, channel) {
  if (channel.messageEncoding !== "json") {
    return null;
  }
  try {
    return JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(message.data));
  } catch (cause) {
    throw new Error(`Message of ${JSON.stringify(channel.topic)} at ${message.logTime} ns is not JSON: ${cause.message}`, { cause });
  }
}

function emptyTopics(reader) {
  const topics = new Map();
  for (const channel of reader.channelsById.values()) {
    const schema = reader.schemasById.get(channel.schemaId);
    topics.set(channel.topic, {
      count: 0,
      schemaName: schema?.name ?? null,
      schemaEncoding: schema?.encoding ?? null,
      messageEncoding: channel.messageEncoding,
      first: null,
      last: null,
    });
  }
  return topics;
}

/** Every topic with its number of messages and its first and last row in log time order. */
async function readTopics(reader) {
  const topics = emptyTopics(reader);
  for await (const message of reader.readMessages({ validateCrcs: true })) {
    const channel = reader.channelsById.get(message.channelId);
    if (channel == undefined) {
      throw new Error(`Message at ${message.logTime} ns is on channel ${message.channelId}, which the summary does not name`);
    }
    const topic = topics.get(channel.topic);
    const row = decode(message, channel);
    topic.first = topic.count === 0 ? row : topic.first;
    topic.last = row;
    topic.count += 1;
  }
  return topics;
}

async function namesOf(records) {
  const names = [];
  for await (const record of records) {
    names.push(record.name);
  }
  return names;
}

/** What the index leads to. */
async function readIndexed(handle, decompressHandlers) {
  const reader = await McapIndexedReader.Initialize({ readable: new Ranges(handle), decompressHandlers });
  const statistics = reader.statistics;
  return {
    library: reader.header.library,
    profile: reader.header.profile,
    topics: Object.fromEntries(await readTopics(reader)),
    messageCount: statistics == undefined ? null : Number(statistics.messageCount),
    metadata: await namesOf(reader.readMetadata()),
    attachments: await namesOf(reader.readAttachments({ validateCrcs: true })),
    startTime: statistics?.messageStartTime.toString() ?? null,
    endTime: statistics?.messageEndTime.toString() ?? null,
  };
}

/** The number of messages met from the first byte to the last, without the index. */
async function countStreamed(handle, decompressHandlers) {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  const piece = new Uint8Array(STREAM_PIECE_BYTES);
  let [count, position] = [0, 0];
  for (;;) {
    const { bytesRead } = await handle.read(piece, 0, piece.length, position);
    if (bytesRead === 0) {
      break;
    }
    position += bytesRead;
    reader.append(piece.subarray(0, bytesRead));
    for (let record; (record = reader.nextRecord()); ) {
      count += record.type === "Message" ? 1 : 0;
    }
  }
  if (!reader.done()) {
    throw new Error(`Stream ended at byte ${position} without a footer`);
  }
  return count;
}

async function read(path, decompressHandlers) {
  const handle = await open(path);
  try {
    const indexed = await readIndexed(handle, decompressHandlers);
    const streamCount = await countStreamed(handle, decompressHandlers);
    const indexedCount = Object.values(indexed.topics).reduce((sum, topic) => sum + topic.count, 0);
    const ok = indexedCount === streamCount && indexed.messageCount === streamCount;
    return { path, ...indexed, streamCount, ok };
  } finally {
    await handle.close();
  }
}

const paths = process.argv.slice(2);
if (paths.length === 0) {
  console.error("usage: node read_mcap.mjs FILE...");
  process.exitCode = 2;
}
const decompressHandlers = await loadDecompressHandlers();
for (const path of paths) {
  try {
    const report = await read(path, decompressHandlers);
    console.log(JSON.stringify(report));
    if (!report.ok) {
      throw new Error("the counts of the index, the stream and the statistics differ");
    }
  } catch (error) {
    console.error(`${path}: ${error.message}`);
    process.exitCode = 1;
  }
}
