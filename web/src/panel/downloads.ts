// What to download: a chooser, and how it gets to the disk.

import { apiKey, downloaded, exported, request, type Job } from "../api";
import { byId, bytes, choice, make } from "../dom";
import { Fault, type Problem } from "../problem";
import type { Manifest } from "../viewer/manifest";
import { HEAD, kitsOf, type Kit } from "./kits";

/** `gone` is told when the files are no longer there. */
export function downloads(job: Job, manifest: Manifest, gone: (problem: Problem) => void, signal: AbortSignal): HTMLElement {
  const kits = kitsOf(manifest, job.id);
  const choices = kits.map((kit, index) => {
    const title = make("b", {}, kit.title, kit.size ? make("span", { class: "time" }, bytes(kit.size)) : "");
    return choice("choice", { name: "kit", value: kit.id, checked: index === 0 }, title, make("small", {}, kit.about));
  });
  const list = make("div", { class: "choices kits", role: "radiogroup", "aria-labelledby": "download-title" }, ...choices);
  const button = make("button", { type: "button", class: "primary big", id: "download" }, "Download");
  const status = make("p", { class: "hint", id: "download-status", role: "status" });
  let doing: AbortController | null = null;

  button.addEventListener("click", () => {
    if (doing) return doing.abort();
    const kit = kits.find((one) => one.id === list.querySelector<HTMLInputElement>("input:checked")!.value)!;
    const mine = (doing = new AbortController());
    signal.addEventListener("abort", () => mine.abort(), { once: true });
    button.textContent = "Cancel";
    status.textContent = "Fetching the files";
    void fetchKit(job, kit, mine.signal, (text) => (status.textContent = text))
      .then((text) => (status.textContent = text))
      .catch((error: unknown) => {
        status.textContent = mine.signal.aborted ? "Cancelled" : `That did not work: ${(error as Error).message}`;
        if (error instanceof Fault && [404, 410].includes(error.problem.status) && !signal.aborted) gone(error.problem);
      })
      .finally(() => {
        doing = null;
        button.textContent = "Download";
      });
  });
  const title = make("h2", { id: "download-title" }, "Download");
  return make("section", { class: "group downloads", "aria-labelledby": "download-title" }, title, list, button, status);
}

async function fetchKit(job: Job, kit: Kit, signal: AbortSignal, told: (text: string) => void): Promise<string> {
  if (kit.from === "export") await fetchFile(await exported(job, kit.id, signal, told), kit.name, signal, told);
  else await fetchFile(kit.from === "archive" ? job.links.archive : `${job.links.files}/${HEAD}`, kit.name, signal, told);
  return `Saved as ${kit.name}`;
}

/** Saves one file. The browser fetches it by itself unless a key has to be sent, which a link cannot do. */
export async function fetchFile(url: string, name: string, signal: AbortSignal, told: (text: string) => void): Promise<void> {
  if (apiKey.get()) {
    const data = await downloaded(url, signal, (have) => told(`Fetching ${bytes(have)}`));
    return save(URL.createObjectURL(data), name);
  }
  // Asked first: of a file that is gone, a browser would save the error message under the file's name.
  await request(url, { method: "HEAD", signal });
  save(url, name);
}

export function save(address: string, name: string): void {
  const link = make("a", { href: address, download: name });
  link.click();
  // The browser has taken the data over by then; revoked at once, some have not.
  if (address.startsWith("blob:")) window.setTimeout(() => URL.revokeObjectURL(address), 60_000);
}

/** A link to one file of the archive. */
export function fileLink(url: string, path: string): HTMLAnchorElement {
  const name = path.split("/").pop()!;
  const link = make("a", { href: url, download: name }, path);
  link.addEventListener("click", (event) => {
    event.preventDefault();
    const say = (text: string) => (byId("live").textContent = text);
    void fetchFile(url, name, new AbortController().signal, say).catch((error: Error) => (byId("view-status").textContent = error.message));
  });
  return link;
}
