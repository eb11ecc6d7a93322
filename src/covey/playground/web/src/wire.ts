// Arrays as they come over the wire, as typed arrays.

import type { Encoded } from "./messages";

interface Arrays {
  f8: Float64Array;
  f4: Float32Array;
  i4: Int32Array;
  u1: Uint8Array;
}

const KINDS = { f8: Float64Array, f4: Float32Array, i4: Int32Array, u1: Uint8Array };

export function bytes(base64: string): Uint8Array<ArrayBuffer> {
  const text = atob(base64);
  const result = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) result[i] = text.charCodeAt(i);
  return result;
}

/** The values of an array, row by row; a copy that the caller may keep. */
export function values<D extends keyof Arrays>(array: Encoded<D>): Arrays[D] {
  return new KINDS[array.dtype](bytes(array.data).buffer) as Arrays[D];
}

/** Polygon rings as lists of flat coordinates [x0, y0, x1, y1, ...]. */
export function rings(encoded: Encoded<"f8">[]): Float64Array[] {
  return encoded.map((ring) => values(ring));
}

/** Unpack base64 of gzipped text. */
export async function unzip(base64: string): Promise<string> {
  const stream = new Blob([bytes(base64)]).stream().pipeThrough(new DecompressionStream("gzip"));
  return await new Response(stream).text();
}
