// What every view is: it fills an element and says how to end what it began.

import { el } from "../dom.ts";
import type { SiteState } from "../site_state.ts";

/** rest: of the address, behind the name. */
export type View = (root: HTMLElement, site: SiteState, name: string, rest: string[]) => () => void;

/** A view in the navigation, of a site or of recordings. */
export interface Entry<State> {
  path: string;
  text: string;
  show: (root: HTMLElement, state: State, name: string, rest: string[]) => () => void;
  scope?: "admin";
}

/** Call something now and then, until the end that it gives. */
export function repeat(work: () => void, ms: number): () => void {
  work();
  const timer = window.setInterval(work, ms);
  return () => window.clearInterval(timer);
}

/** What went wrong, in the server's sentence. */
export function sentenceOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

/** A view of points where there are none. */
export function nothing(root: HTMLElement, title: string): () => void {
  root.replaceChildren(el("h1", {}, title), el("p", {}, "There are no points yet."));
  return () => undefined;
}
