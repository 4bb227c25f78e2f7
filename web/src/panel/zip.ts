// A zip of files as they are, without compression: PNG and GLB are dense already. PKWARE APPNOTE 6.3.10, sections 4.3.7,
// 4.3.12, 4.3.16.

export interface Entry {
  name: string;
  data: Blob;
}

const VERSION = 20;
const UTF8_NAMES = 0x0800;
/** 1 January 1980, 0 h: the first moment that the format knows, so that the same files make the same zip. */
const DATE = 0x0021;

/** Files must be under 4 GiB together, as there are no zip64 records. */
export async function zipOf(entries: Entry[]): Promise<Blob> {
  const parts: BlobPart[] = [];
  const directory: BlobPart[] = [];
  let offset = 0;
  let length = 0;
  for (const { name, data } of entries) {
    const bytes = new TextEncoder().encode(name);
    const common = fields([2, VERSION], [2, UTF8_NAMES], [2, 0], [2, 0], [2, DATE], [4, await crc32(data)], [4, data.size], [4, data.size], [2, bytes.length], [2, 0]);
    const local = [fields([4, 0x04034b50]), common, bytes];
    const central = [fields([4, 0x02014b50], [2, VERSION]), common, fields([2, 0], [2, 0], [2, 0], [4, 0], [4, offset]), bytes];
    parts.push(...local, data);
    directory.push(...central);
    offset += sizeOf(local) + data.size;
    length += sizeOf(central);
  }
  const end = fields([4, 0x06054b50], [2, 0], [2, 0], [2, entries.length], [2, entries.length], [4, length], [4, offset], [2, 0]);
  return new Blob([...parts, ...directory, end], { type: "application/zip" });
}

/** Little-endian numbers of so many bytes each. */
function fields(...values: [size: 2 | 4, value: number][]): Uint8Array<ArrayBuffer> {
  const made = new Uint8Array(values.reduce((sum, [size]) => sum + size, 0));
  const view = new DataView(made.buffer);
  let at = 0;
  for (const [size, value] of values) {
    if (size === 2) view.setUint16(at, value, true);
    else view.setUint32(at, value, true);
    at += size;
  }
  return made;
}

function sizeOf(parts: Uint8Array[]): number {
  return parts.reduce((sum, part) => sum + part.length, 0);
}

const TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let value = byte;
  for (let bit = 0; bit < 8; bit++) value = value & 1 ? 0xedb88320 ^ (value >>> 1) : value >>> 1;
  return value;
});

async function crc32(data: Blob): Promise<number> {
  let value = 0xffffffff;
  const reader = data.stream().getReader();
  for (let part = await reader.read(); !part.done; part = await reader.read())
    for (const byte of part.value) value = TABLE[(value ^ byte) & 255]! ^ (value >>> 8);
  return (value ^ 0xffffffff) >>> 0;
}
