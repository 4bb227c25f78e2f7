// The page: photo and options, the job at work, the head.

import { apiKey, newKey, readJob, remove, submit, type Job, type Options } from "./api";
import { byId } from "./dom";
import { chooseFace } from "./faces";
import { follow } from "./follow";
import { showGone } from "./gone";
import { Intake } from "./intake";
import { Fault, type Problem } from "./problem";
import { samplePhoto } from "./sample";
import { wipe } from "./wipe";
import { Work } from "./work";

const SCREENS = ["intake", "faces", "work", "result", "gone"] as const;
type Screen = (typeof SCREENS)[number];

/** What a job was made from; no photos where the page took it up by its address. */
interface Origin {
  options: Options;
  photos: readonly File[];
}

const never = () => undefined;
let doing = new AbortController();
let job: Job | null = null;
let retry: () => void = never;
let close: () => void = never;

// A browser of a phone says "coarse pointer" only where it has no pen and no mouse; touch is what matters here.
document.body.classList.toggle("touch", navigator.maxTouchPoints > 0);
const intake = new Intake(() => clearFault(), (problem) => fail(problem));
const work = new Work();
wipe(byId("gallery-wipe"));

byId("intake").addEventListener("submit", (event) => {
  event.preventDefault();
  void handIn();
});
for (const id of ["try", "try-too"]) byId(id).addEventListener("click", () => void trySample());
byId("cancel").addEventListener("click", () => void cancel());
for (const id of ["restart", "restart-gone", "restart-faces"]) byId(id).addEventListener("click", () => startAgain());
byId("again").addEventListener("click", () => retry());
byId<HTMLFormElement>("key-form").addEventListener("submit", (event) => {
  event.preventDefault();
  apiKey.set(byId<HTMLInputElement>("key").value.trim());
  retry();
});
window.addEventListener("hashchange", () => void resume());
void resume();

/** Begins, once the photos that were chosen just now have been looked at: a file may be slow to read. */
async function handIn(): Promise<void> {
  await intake.ready();
  const options = intake.options();
  if (!intake.photos.length) fail({ title: "There is no photo yet", status: 400, detail: "Drop one on the field, or choose one." });
  else if (options.maps?.length === 0) fail({ title: "No map is chosen", status: 400, detail: "Choose one or more." });
  else void create(options);
}

/** Hands in the photo. The key stays the same over retries, so that a lost answer does not make two jobs. */
async function create(options: Options, key = newKey()): Promise<void> {
  const photos = intake.photos;
  const signal = begin();
  show("work");
  work.start(photos[0], intake.expected(options));
  byId("work-title").focus();
  await guarded(signal, () => void create(options, key), async () => {
    job = await submit(photos, options, key, (share) => work.sent(share), signal, intake.keeps());
    history.replaceState(null, "", `#avatar=${job.id}`);
    await finish(await watch(job, signal), signal, { options, photos });
  });
}

async function trySample(): Promise<void> {
  const signal = begin();
  await guarded(signal, () => void trySample(), async () => {
    intake.take([await samplePhoto(signal)]);
    await create(intake.quickOptions());
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
      work.start(undefined, null);
    }
    await finish(await watch(found, signal), signal, { options: {}, photos: [] });
  });
}

async function watch(start: Job, signal: AbortSignal): Promise<Job> {
  work.show(start);
  return follow(start, (now) => work.show((job = now)), (yes) => work.lost(yes), signal);
}

async function finish(done: Job, signal: AbortSignal, origin: Origin): Promise<void> {
  work.stop();
  job = done;
  if (done.state === "succeeded") return open(done, signal, origin);
  const boxes = done.error?.boxes;
  if (done.state === "failed" && done.error?.code === "multiple-faces" && boxes) return ask(boxes, done.error.photo ?? 0, origin);
  if (done.state === "failed") throw new Fault(done.error ?? { title: "The job failed", status: 500 });
  if (done.state === "expired") throw new Fault({ title: "The head has expired", status: 410, reason: "expired" });
  throw new Fault({ title: "Cancelled", status: 409, detail: "This head was cancelled before it was done." });
}

/** Several faces: a question, not an error. Without the photo, after a reload, it has to be chosen again first. */
function ask(boxes: NonNullable<Problem["boxes"]>, which: number, { options, photos }: Origin): void {
  reset();
  if (!photos.length) {
    byId("ask-again").textContent = `There are ${boxes.length} faces in that photo. Choose the photo again to say whose head it is to be.`;
    byId("ask-again").hidden = false;
    return;
  }
  show("faces");
  byId("live").textContent = `${boxes.length} faces were found`;
  chooseFace(boxes, photos[which]!, (face) => void create({ ...options, face }));
}

async function open(done: Job, signal: AbortSignal, { photos }: Origin): Promise<void> {
  show("result");
  byId("live").textContent = "The head is ready";
  byId("result-title").focus();
  window.scrollTo(0, 0);
  const again = (options: Options, files: readonly File[]) => {
    if (files.length) intake.take(files);
    void create(options);
  };
  const { openResult } = await loadViewer();
  if (signal.aborted) return;
  close = await openResult(done, { photos, erase: () => void erase(done), again, gone }, signal);
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
  const problem = fault?.problem ?? { title: "This page made a mistake", status: 0, detail: String(error) };
  if (problem.status === 410 || problem.status === 404) gone(problem);
  else fail(problem, again, fault?.retryAfter);
}

function gone(problem: Problem): void {
  reset();
  show("gone");
  showGone(problem);
}

function fail(problem: Problem, again: (() => void) | null = null, retryAfter?: number | null): void {
  if (byId("result").hidden) reset();
  retry = again ?? never;
  byId("fault-title").textContent = problem.title;
  const later = retryAfter ? ` Try again in ${retryAfter} s.` : "";
  byId("fault-detail").textContent = intake.blamed(problem) + later;
  byId("key-form").hidden = problem.status !== 401;
  byId("again").hidden = !again || !(problem.status === 0 || problem.status === 429 || problem.status >= 500);
  byId("fault").hidden = false;
  byId("fault").focus();
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

function startAgain(): void {
  reset();
  intake.take([]);
  byId("file").focus();
}

function clearFault(): void {
  byId("fault").hidden = byId("ask-again").hidden = true;
}

function show(screen: Screen): void {
  for (const name of SCREENS) byId(name).hidden = name !== screen;
  byId("gallery").hidden = screen !== "intake";
  byId("restart").hidden = screen !== "result";
  document.body.dataset.screen = screen;
}
