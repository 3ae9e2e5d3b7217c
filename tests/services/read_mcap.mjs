// Every message of an MCAP file as @mcap/core and @foxglove/rosmsg2-serialization read it: one JSON object a line.
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const [folder, file] = process.argv.slice(2);
const require = createRequire(`${folder}/package.json`);
const { McapStreamReader } = require("@mcap/core");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

const plain = (key, value) => {
  if (typeof value === "bigint") return Number(value);
  if (value instanceof Uint8Array) return createHash("sha256").update(value).digest("hex");
  if (ArrayBuffer.isView(value)) return Array.from(value);
  return value;
};

const stream = new McapStreamReader({ validateCrcs: true });
stream.append(readFileSync(file));
const schemas = new Map();
const channels = new Map();
for (let record; (record = stream.nextRecord()); ) {
  if (record.type === "Schema") {
    const text = new TextDecoder().decode(record.data);
    schemas.set(record.id, new MessageReader(parse(text, { ros2: true })));
  } else if (record.type === "Channel") {
    channels.set(record.id, record);
  } else if (record.type === "Message") {
    const channel = channels.get(record.channelId);
    const message = schemas.get(channel.schemaId).readMessage(record.data);
    console.log(JSON.stringify({ topic: channel.topic, logTime: String(record.logTime), message }, plain));
  }
}
