// Errors as the service tells them: RFC 9457 problem objects.

export interface Problem {
  title: string;
  status: number;
  detail?: string;
  code?: string;
  instance?: string;
  /** Why a result is gone: expired, erased, lost. */
  reason?: string;
  boxes?: Box[];
  /** Which of several photos it is about, from 0. */
  photo?: number;
}

/** left, top, right, bottom in pixels of the upright photo. */
export type Box = [number, number, number, number];

export class Fault extends Error {
  constructor(
    readonly problem: Problem,
    readonly retryAfter: number | null = null,
  ) {
    super(problem.detail ?? problem.title);
  }
}

/** The answer never came. */
export class Unreachable extends Fault {
  constructor() {
    super({
      title: "The service cannot be reached",
      status: 0,
      detail: "Check the connection, then try again. Nothing is made twice.",
    });
  }
}

export function isBox(value: unknown): value is Box {
  return Array.isArray(value) && value.length === 4 && value.every((side) => Number.isFinite(side));
}

/** Reads a problem object; what is none gets a plain one with the status. */
export function problemOf(content: unknown, status: number): Problem {
  const given = (typeof content === "object" && content !== null ? content : {}) as Record<string, unknown>;
  const text = (name: string) => (typeof given[name] === "string" ? (given[name] as string) : undefined);
  const boxes = Array.isArray(given.boxes) && given.boxes.every(isBox) ? (given.boxes as Box[]) : undefined;
  return {
    title: text("title") ?? "The service could not do this",
    status: typeof given.status === "number" ? given.status : status,
    detail: text("detail") ?? (text("title") ? undefined : `It answered with status ${status}.`),
    code: text("code"),
    instance: text("instance"),
    reason: text("reason"),
    boxes,
    photo: Number.isInteger(given.photo) ? (given.photo as number) : undefined,
  };
}
