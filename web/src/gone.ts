// A link to a head that is not there any more: why, and what to do.

import { byId } from "./dom";
import type { Problem } from "./problem";

const WORDS: Record<string, [title: string, text: string]> = {
  expired: [
    "This head has expired",
    "Heads are kept for a limited time, then erased from the server with all their files. Make it again from the photo.",
  ],
  erased: ["This head was deleted", "Its files were erased from the server. Make it again from the photo."],
  lost: ["The files of this head are lost", "The server no longer has them. Make it again from the photo."],
  unknown: [
    "There is no head at this link",
    "The link is incomplete, was made with another access key, or the head was erased long ago.",
  ],
};

export function showGone(problem: Problem): void {
  const [title, text] = WORDS[reasonOf(problem)]!;
  byId("gone-title").textContent = title;
  byId("gone-text").textContent = text;
  byId("gone").hidden = false;
  byId("gone-title").focus();
}

function reasonOf(problem: Problem): string {
  if (problem.status === 404) return "unknown";
  return problem.reason && problem.reason in WORDS ? problem.reason : "expired";
}
