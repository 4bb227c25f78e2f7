// A job's progress: server-sent events as long as they come, polling whenever they do not.

import { merged, readJob, request, wait, type Job } from "./api";
import { Fault, Unreachable } from "./problem";

const SILENCE_MS = 45_000; // three of the server's heartbeats
const FIRST_PAUSE_MS = 700;
const LONGEST_PAUSE_MS = 8_000;

export const FINAL = new Set(["succeeded", "failed", "cancelled", "expired"]);

/**
 * Follows a job to its end, over broken connections too.
 *
 * `seen` gets every new state, `lost` whether the service cannot be reached at the moment.
 */
export async function follow(
  start: Job,
  seen: (job: Job) => void,
  lost: (yes: boolean) => void,
  signal: AbortSignal,
): Promise<Job> {
  let job = start;
  let last = "";
  let pause = FIRST_PAUSE_MS;
  const take = (content: unknown) => {
    job = merged(job, content);
    lost(false);
    seen(job);
  };
  while (!FINAL.has(job.state)) {
    try {
      for await (const event of events(job.links.events, last, signal)) {
        last = event.id;
        pause = FIRST_PAUSE_MS;
        if (event.name === "progress" || event.name === "state") take(event.data);
        if (FINAL.has(job.state)) break;
      }
    } catch {
      if (signal.aborted) throw signal.reason;
    }
    // The whole state once more: an event may lack the links, or the stream broke before the last one.
    try {
      take(await readJob(job.id, signal));
    } catch (error) {
      if (signal.aborted) throw signal.reason;
      if (error instanceof Fault && !(error instanceof Unreachable) && error.problem.status < 500 && error.problem.status !== 429)
        throw error;
      lost(true);
    }
    if (!FINAL.has(job.state)) await wait(pause, signal);
    pause = Math.min(pause * 1.5, LONGEST_PAUSE_MS);
  }
  return job;
}

interface Message {
  name: string;
  id: string;
  data: unknown;
}

/** Events by fetch rather than EventSource, which cannot send a key and hides why it failed. */
async function* events(url: string, last: string, signal: AbortSignal): AsyncGenerator<Message> {
  const silence = new AbortController();
  const both = AbortSignal.any ? AbortSignal.any([signal, silence.signal]) : signal;
  const answer = await request(url, {
    signal: both,
    cache: "no-store",
    headers: { Accept: "text/event-stream", ...(last ? { "Last-Event-ID": last } : {}) },
  });
  if (!answer.body || !answer.headers.get("Content-Type")?.startsWith("text/event-stream"))
    throw new Error("no event stream");
  const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  let timer = 0;
  try {
    while (true) {
      timer = window.setTimeout(() => silence.abort(), SILENCE_MS);
      const { done, value } = await reader.read();
      window.clearTimeout(timer);
      if (done) return;
      const blocks = (rest + value).replaceAll("\r\n", "\n").split("\n\n");
      rest = blocks.pop() ?? "";
      for (const block of blocks) {
        const message = parse(block, last);
        last = message.id;
        if (message.data !== undefined) yield message;
      }
    }
  } finally {
    window.clearTimeout(timer);
    await reader.cancel().catch(() => undefined);
  }
}

function parse(block: string, last: string): Message {
  const message: Message = { name: "message", id: last, data: undefined };
  const data: string[] = [];
  for (const line of block.split("\n")) {
    const [, name, value] = /^([a-z]+): ?(.*)$/.exec(line) ?? [];
    if (name === "event") message.name = value!;
    else if (name === "id") message.id = value!;
    else if (name === "data") data.push(value!);
  }
  try {
    if (data.length) message.data = JSON.parse(data.join("\n"));
  } catch {
    // Not JSON: nothing that this page knows.
  }
  return message;
}
