// The job at work: stage, bar, what is done.

import type { Job } from "./api";
import { byId, duration, make, words } from "./dom";
import { timeInWords, type Expected } from "./times";

const STAGES: Record<string, string> = {
  decode: "Reading the photo",
  detect: "Finding the face",
  fit: "Fitting the head",
  texture: "Unwrapping the texture",
  compare: "Comparing with the photo",
  super_resolution: "Enlarging the texture",
  diffuse_albedo: "Taking the light out",
  specular_albedo: "Finding the gloss",
  specular_normal: "Finding pores and wrinkles",
  diffuse_normal: "Softening for the skin",
  displacement: "Raising the relief",
  write: "Writing the archive",
  pack: "Writing the archive",
};

export class Work {
  private stage = "";
  private began = 0;
  private stageBegan = 0;
  private timer = 0;
  private expected: Expected | null = null;

  /** `expected`: the time that was told before the start, shown beside the time that has passed. */
  start(file: File | undefined, expected: Expected | null): void {
    this.stage = "";
    this.expected = expected;
    this.began = this.stageBegan = performance.now();
    byId("work-done").replaceChildren();
    byId("work-lost").hidden = true;
    const photo = byId<HTMLImageElement>("work-photo");
    photo.hidden = true;
    if (file) {
      photo.onload = () => (photo.hidden = false);
      URL.revokeObjectURL(photo.src);
      photo.src = URL.createObjectURL(file);
    }
    this.say("Sending the photo", 0);
    window.clearInterval(this.timer);
    this.timer = window.setInterval(() => this.tick(), 1000);
    byId("work-time").textContent = "";
  }

  stop(): void {
    window.clearInterval(this.timer);
  }

  sent(share: number): void {
    byId("work-stage").textContent = share < 1 ? `Sending the photo, ${Math.round(100 * share)} %` : "Waiting for an answer";
  }

  show(job: Job): void {
    if (job.state === "queued") this.say("Waiting for its turn", job.progress);
    else if (job.stage) this.enter(job.stage, job.progress);
    else byId<HTMLProgressElement>("work-bar").value = job.progress;
  }

  lost(yes: boolean): void {
    byId("work-lost").hidden = !yes;
  }

  private enter(stage: string, progress: number): void {
    if (stage !== this.stage) {
      if (this.stage) this.finish(this.stage);
      this.stage = stage;
      this.stageBegan = performance.now();
    }
    this.say(STAGES[stage] ?? words(stage), progress);
  }

  private finish(stage: string): void {
    const took = (performance.now() - this.stageBegan) / 1000;
    byId("work-done").append(make("li", {}, STAGES[stage] ?? words(stage), make("span", { class: "soft" }, duration(took))));
  }

  private say(text: string, progress: number): void {
    byId<HTMLProgressElement>("work-bar").value = progress;
    if (byId("work-stage").textContent === text) return;
    byId("work-stage").textContent = text;
    byId("live").textContent = text;
  }

  private tick(): void {
    const seconds = (performance.now() - this.began) / 1000;
    const usual = timeInWords(this.expected);
    const late = this.expected !== null && seconds > 1.2 * this.expected.seconds;
    byId("work-time").textContent = `${duration(seconds)}${usual && (late ? `; it was to take ${usual}` : ` of ${usual}`)}`;
  }
}
