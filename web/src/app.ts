// The page: photo and options, the job at work, the head.

import { apiKey, newKey, readJob, remove, submit, type Job } from "./api";
import { byId } from "./dom";
import { chooseFace } from "./faces";
import { follow } from "./follow";
import { Intake } from "./intake";
import { Fault, type Problem } from "./problem";
import { Work } from "./work";

type Screen = "intake" | "work" | "result";

const never = () => undefined;
let doing = new AbortController();
let job: Job | null = null;
let retry: () => void = never;
let close: () => void = never;

// A browser of a phone says "coarse pointer" only where it has no pen and no mouse; touch is what matters here.
document.body.classList.toggle("touch", navigator.maxTouchPoints > 0);
const intake = new Intake(() => clearFault());
const work = new Work();

byId("intake").addEventListener("submit", (event) => {
  event.preventDefault();
  if (!intake.photo) fail({ title: "There is no photo yet", status: 400, detail: "Drop one on the field, or choose one." }, never);
  else if (intake.options().maps?.length === 0) fail({ title: "No map is chosen", status: 400, detail: "Choose one or more." }, never);
  else void create();
});
byId("cancel").addEventListener("click", () => void cancel());
byId("restart").addEventListener("click", () => reset());
byId("again").addEventListener("click", () => retry());
byId<HTMLFormElement>("key-form").addEventListener("submit", (event) => {
  event.preventDefault();
  apiKey.set(byId<HTMLInputElement>("key").value.trim());
  retry();
});
window.addEventListener("hashchange", () => void resume());
void resume();

/** Hands in the photo. The key stays the same over retries, so that a lost answer does not make two jobs. */
async function create(face?: number, key = newKey()): Promise<void> {
  const photo = intake.photo!;
  const options = { ...intake.options(), ...(face === undefined ? {} : { face }) };
  const signal = begin();
  show("work");
  work.start(intake.photoUrl);
  byId("work-title").focus();
  await guarded(signal, () => void create(face, key), async () => {
    job = await submit(photo, options, key, (share) => work.sent(share), signal);
    history.replaceState(null, "", `#avatar=${job.id}`);
    await finish(await watch(job, signal), signal);
  });
}

/** Takes up the job that the address names. */
async function resume(): Promise<void> {
  const id = /^#avatar=([\w-]{1,128})$/.exec(location.hash)?.[1];
  if (!id || id === job?.id) return;
  const signal = begin();
  await guarded(signal, () => void resume(), async () => {
    const found = await readJob(id, signal);
    if (found.state === "queued" || found.state === "running") {
      show("work");
      work.start("");
    }
    await finish(await watch(found, signal), signal);
  });
}

async function watch(start: Job, signal: AbortSignal): Promise<Job> {
  work.show(start);
  return follow(start, (now) => work.show((job = now)), (yes) => work.lost(yes), signal);
}

async function finish(done: Job, signal: AbortSignal): Promise<void> {
  work.stop();
  job = done;
  if (done.state === "succeeded") return open(done, signal);
  if (done.state === "failed") throw new Fault(done.error ?? { title: "The job failed", status: 500 });
  throw new Fault({ title: done.state === "cancelled" ? "Cancelled" : "The head has expired", status: 410 });
}

async function open(done: Job, signal: AbortSignal): Promise<void> {
  show("result");
  byId("live").textContent = "The head is ready";
  byId("result-title").focus();
  const { openResult } = await loadViewer();
  if (signal.aborted) return;
  close = await openResult(done, () => void erase(done), signal);
}

function loadViewer(): Promise<typeof import("./viewer")> {
  return import("./viewer.js" as string).catch(() => {
    throw new Fault({ title: "The viewer could not be loaded", status: 0, detail: "Reload the page to try again." });
  });
}

async function cancel(): Promise<void> {
  const running = job;
  reset();
  byId("live").textContent = "Cancelled";
  if (running) await remove(running).catch((error: unknown) => report(error, () => void remove(running)));
}

async function erase(done: Job): Promise<void> {
  try {
    await remove(done);
    reset();
    byId("live").textContent = "Deleted";
  } catch (error) {
    report(error, () => void erase(done));
  }
}

async function guarded(signal: AbortSignal, again: () => void, action: () => Promise<void>): Promise<void> {
  try {
    await action();
  } catch (error) {
    if (signal.aborted) return;
    work.stop();
    report(error, again);
  }
}

function report(error: unknown, again: () => void): void {
  const fault = error instanceof Fault ? error : null;
  if (!fault) console.error(error);
  fail(fault?.problem ?? { title: "This page made a mistake", status: 0, detail: String(error) }, again, fault?.retryAfter);
}

function fail(problem: Problem, again: () => void, retryAfter?: number | null): void {
  if (byId("result").hidden || problem.status === 410 || problem.status === 404) reset();
  retry = again;
  byId("fault-title").textContent = problem.title;
  const later = retryAfter ? ` Try again in ${retryAfter} s.` : "";
  byId("fault-detail").textContent = (problem.detail ?? "") + later;
  byId("key-form").hidden = problem.status !== 401;
  byId("again").hidden = !(problem.status === 0 || problem.status === 429 || problem.status >= 500) || !intake.photo;
  byId("fault").hidden = false;
  byId("fault").focus();
  if (problem.boxes && intake.photo) chooseFace(problem.boxes, intake.photoUrl, (face) => void create(face));
}

function begin(): AbortSignal {
  doing.abort();
  close();
  close = never;
  doing = new AbortController();
  job = null;
  clearFault();
  return doing.signal;
}

function reset(): void {
  begin();
  work.stop();
  history.replaceState(null, "", location.pathname + location.search);
  show("intake");
}

function clearFault(): void {
  byId("fault").hidden = byId("faces").hidden = true;
}

function show(screen: Screen): void {
  for (const name of ["intake", "work", "result"]) byId(name).hidden = name !== screen;
  byId("restart").hidden = screen !== "result";
  document.body.dataset.screen = screen;
}
