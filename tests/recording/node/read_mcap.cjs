// Every message of an MCAP file as a line of JSON, read and decoded by the npm packages of Foxglove.
// node read_mcap.cjs FOLDER_OF_NODE_MODULES FILE
"use strict";
const { createHash } = require("node:crypto");
const { open } = require("node:fs/promises");
const { createRequire } = require("node:module");
const path = require("node:path");

async function main(modules, file) {
  const load = createRequire(path.join(path.resolve(modules), "index.js"));
  const { McapIndexedReader } = load("@mcap/core");
  const { decompress } = load("fzstd");
  const { parse } = load("@foxglove/rosmsg");
  const { MessageReader } = load("@foxglove/rosmsg2-serialization");

  const handle = await open(file, "r");
  const readable = {
    size: async () => BigInt((await handle.stat()).size),
    read: async (offset, length) => {
      const buffer = new Uint8Array(Number(length));
      await handle.read(buffer, 0, Number(length), Number(offset));
      return buffer;
    },
  };
  const reader = await McapIndexedReader.Initialize({
    readable,
    decompressHandlers: { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) },
  });
  const decoders = new Map();
  const lines = [];
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    const schema = reader.schemasById.get(channel.schemaId);
    if (!decoders.has(schema.id)) {
      decoders.set(schema.id, new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })));
    }
    lines.push(
      JSON.stringify({
        topic: channel.topic,
        type: schema.name,
        log_time: String(message.logTime),
        publish_time: String(message.publishTime),
        sequence: message.sequence,
        sha256: createHash("sha256").update(message.data).digest("hex"),
        value: plain(decoders.get(schema.id).readMessage(message.data)),
      }),
    );
  }
  await handle.close();
  process.stdout.write(lines.map((line) => line + "\n").join(""));
}

function plain(value) {
  if (typeof value === "bigint") return String(value);
  if (ArrayBuffer.isView(value) || Array.isArray(value)) return Array.from(value, plain);
  if (value !== null && typeof value === "object") {
    return Object.fromEntries(Object.entries(value).map(([key, entry]) => [key, plain(entry)]));
  }
  return value;
}

main(process.argv[2], process.argv[3]).catch((error) => {
  process.stderr.write(`${error.stack}\n`);
  process.exit(1);
});
