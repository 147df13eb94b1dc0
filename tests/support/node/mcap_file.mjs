// What the viewers' reader of MCAP needs of its surroundings: decompressors, and a file as ranges of bytes.

import lz4 from "@foxglove/wasm-lz4";
import zstd from "@foxglove/wasm-zstd";

/** The decompressors of the viewers, called as `@mcap/support` calls them. */
export async function loadDecompressHandlers() {
  await Promise.all([lz4.isLoaded, zstd.isLoaded]);
  return {
    lz4: (data, size) => new Uint8Array(lz4(data, Number(size))),
    zstd: (data, size) => new Uint8Array(zstd.decompress(data, Number(size))),
  };
}

/** A file as the indexed reader wants it: ranges of bytes, each in a buffer of its own. */
export class Ranges {
  constructor(handle) {
    this.handle = handle;
  }

  async size() {
    return BigInt((await this.handle.stat()).size);
  }

  async read(offset, length) {
    const whole = await this.size();
    if (offset + length > whole) {
      throw new Error(`Range of ${length} bytes at ${offset} reaches beyond the file's ${whole} bytes`);
    }
    const data = new Uint8Array(Number(length));
    let filled = 0;
    while (filled < data.length) {
      const { bytesRead } = await this.handle.read(data, filled, data.length - filled, Number(offset) + filled);
      if (bytesRead === 0) {
        throw new Error(`File ended while reading ${length} bytes at ${offset}`);
      }
      filled += bytesRead;
    }
    return data;
  }
}
