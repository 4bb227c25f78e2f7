// The service's HTTP interface, as far as this page uses it.

import { hex } from "./dom";
import { Fault, problemOf, Unreachable, type Problem } from "./problem";

export type State = "queued" | "running" | "succeeded" | "failed" | "cancelled" | "expired";

export interface Job {
  id: string;
  state: State;
  stage: string;
  progress: number;
  error: Problem | null;
  warnings: string[];
  expires_at: string | null;
  links: { self: string; events: string; archive: string; files: string };
}

export interface Options {
  quality?: string;
  hair?: string;
  hair_colour?: string;
  hair_length?: number;
  maps?: string[];
  face?: number | "largest";
  eye_colour?: string;
  mouth?: string;
  wrinkles?: string;
}

const KEY = "avatarme-key";
const ROOT = new URL("v1/avatars", document.baseURI).pathname;

export const apiKey = {
  get: () => sessionStorage.getItem(KEY) ?? "",
  set: (value: string) => sessionStorage.setItem(KEY, value),
};

export function headers(more: Record<string, string> = {}): Record<string, string> {
  return apiKey.get() ? { Authorization: `Bearer ${apiKey.get()}`, ...more } : more;
}

/** fetch that throws Fault for every answer but a good one. */
export async function request(url: string, init: RequestInit = {}): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(url, { ...init, headers: headers(init.headers as Record<string, string>) });
  } catch (error) {
    if (init.signal?.aborted) throw error;
    throw new Unreachable();
  }
  if (answer.ok) return answer;
  const content: unknown = await answer.json().catch(() => null);
  throw new Fault(problemOf(content, answer.status), seconds(answer.headers.get("Retry-After")));
}

/** The body of an answer, with how many bytes have come so far. */
export async function downloaded(url: string, signal: AbortSignal, told: (have: number) => void): Promise<Blob> {
  const answer = await request(url, { signal });
  const chunks: BlobPart[] = [];
  let have = 0;
  const reader = answer.body!.getReader();
  try {
    for (let part = await reader.read(); !part.done; part = await reader.read()) {
      chunks.push(part.value as BlobPart);
      told((have += part.value.length));
    }
  } catch (error) {
    if (signal.aborted) throw error;
    throw new Unreachable();
  }
  return new Blob(chunks);
}

/** Merges what an answer or event says of a job into what is known of it. */
export function merged(job: Job | null, content: unknown, id = ""): Job {
  const given = (typeof content === "object" && content !== null ? content : {}) as Partial<Job>;
  const links = (given.links ?? {}) as Partial<Job["links"]>;
  const name = given.id ?? job?.id ?? id;
  const self = links.self ?? job?.links.self ?? `${ROOT}/${name}`;
  return {
    id: name,
    state: given.state ?? job?.state ?? "queued",
    stage: given.stage ?? job?.stage ?? "",
    progress: Number.isFinite(given.progress) ? Math.min(Math.max(given.progress!, 0), 1) : (job?.progress ?? 0),
    error: given.error ? problemOf(given.error, 500) : (job?.error ?? null),
    warnings: Array.isArray(given.warnings) ? given.warnings.map(String) : (job?.warnings ?? []),
    expires_at: given.expires_at ?? job?.expires_at ?? null,
    links: {
      self,
      events: links.events ?? job?.links.events ?? `${self}/events`,
      archive: links.archive ?? job?.links.archive ?? `${self}/archive.zip`,
      files: (links.files ?? job?.links.files ?? `${self}/files`).replace(/\/$/, ""),
    },
  };
}

export async function readJob(id: string, signal?: AbortSignal): Promise<Job> {
  const answer = await request(`${ROOT}/${encodeURIComponent(id)}`, { signal });
  return merged(null, await answer.json(), id);
}

/** Address of a kit of a finished head, once the server has made it. */
export async function exported(job: Job, tool: string, signal: AbortSignal, told: (text: string) => void): Promise<string> {
  const wish = { method: "POST", body: JSON.stringify({ avatar: job.id, for: tool }), headers: { "Content-Type": "application/json" }, signal };
  let made = await (await request(new URL("v1/exports", document.baseURI).pathname, wish)).json();
  while (made.state === "queued" || made.state === "running") {
    told(made.state === "queued" ? "Waiting for its turn" : "The server makes the kit");
    await wait(1000, signal);
    made = await (await request(made.links.self, { signal })).json();
  }
  if (made.state !== "succeeded") throw new Fault(problemOf(made.error, 500));
  return made.links.kit;
}

export function wait(ms: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(resolve, ms);
    signal.addEventListener("abort", () => (clearTimeout(timer), reject(signal.reason)), { once: true });
  });
}

export async function remove(job: Job): Promise<void> {
  await request(job.links.self, { method: "DELETE" });
}

/** Hands in photos of one person; `keep` has the server keep them, and what it computes of them. XMLHttpRequest, because fetch does not tell how much of a body was sent. */
export function submit(
  photos: readonly File[],
  options: Options,
  key: string,
  sent: (share: number) => void,
  signal: AbortSignal,
  keep: boolean,
): Promise<Job> {
  const body = new FormData();
  // Options first: the server can refuse them before the photo has arrived.
  body.append("options", new Blob([JSON.stringify(options)], { type: "application/json" }));
  if (keep) body.append("keep_photo", "true");
  for (const photo of photos) body.append("image", photo, "photo");
  return new Promise((resolve, reject) => {
    const call = new XMLHttpRequest();
    call.open("POST", ROOT);
    call.responseType = "text";
    for (const [name, value] of Object.entries(headers({ "Idempotency-Key": key, Accept: "application/json" })))
      call.setRequestHeader(name, value);
    call.upload.onprogress = (event) => event.lengthComputable && sent(event.loaded / event.total);
    call.onerror = () => reject(new Unreachable());
    call.onabort = () => reject(new DOMException("cancelled", "AbortError"));
    call.onload = () => {
      const content = parsed(call.responseText);
      if (call.status >= 200 && call.status < 300) {
        const place = call.getResponseHeader("Location") ?? "";
        resolve(merged(null, content, place.split("/").pop()));
      } else reject(new Fault(problemOf(content, call.status), seconds(call.getResponseHeader("Retry-After"))));
    };
    signal.addEventListener("abort", () => call.abort(), { once: true });
    call.send(body);
  });
}

/** Not crypto.randomUUID: that is missing where the page comes over plain HTTP from another machine. */
export function newKey(): string {
  return hex(crypto.getRandomValues(new Uint8Array(16)));
}

function parsed(text: string): unknown {
  try {
    return JSON.parse(text);
  } catch {
    return null;
  }
}

function seconds(value: string | null): number | null {
  const count = Number(value);
  return value && Number.isFinite(count) ? count : null;
}
