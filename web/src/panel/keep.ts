// How long the head is kept, its link, and deleting it, far from the downloads.

import type { Job } from "../api";
import { byId, make } from "../dom";

export function keeping(job: Job, erase: () => void): HTMLElement {
  const remove = make("button", { type: "button", class: "danger", id: "delete" }, "Delete this head");
  remove.addEventListener("click", () => confirm(erase));
  const row = make("div", { class: "row" });
  const status = make("span", { class: "hint", role: "status" });
  // Missing where the page comes over plain HTTP from another machine.
  if (navigator.clipboard) {
    const copy = make("button", { type: "button", id: "copy-link" }, "Copy link");
    copy.addEventListener("click", () => {
      void navigator.clipboard
        .writeText(location.href)
        .then(() => (status.textContent = "Copied"))
        .catch(() => (status.textContent = "Copy it from the address bar"));
    });
    row.append(copy);
  }
  row.append(remove, status);
  const title = make("h2", { id: "keep-title" }, "On the server");
  return make("section", { class: "keep", "aria-labelledby": "keep-title" }, title, make("p", { class: "hint" }, expiry(job)), row);
}

function expiry(job: Job): string {
  const date = job.expires_at ? new Date(job.expires_at) : null;
  if (!date || Number.isNaN(date.getTime())) return "The head is kept for a limited time.";
  const time = date.toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
  return date.getTime() < Date.now()
    ? `The link expired on ${time}; the files may be erased at any moment.`
    : `The head is kept until ${time}; until then this page's address leads back to it.`;
}

function confirm(erase: () => void): void {
  const dialog = byId<HTMLDialogElement>("confirm");
  for (const button of dialog.querySelectorAll("button"))
    button.onclick = () => {
      dialog.close();
      if (button.value === "delete") erase();
    };
  dialog.showModal();
}
