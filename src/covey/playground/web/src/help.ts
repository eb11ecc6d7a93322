// The keys and the signs, listed with `?`.

import { button, element, make } from "./dom";
import type { Session } from "./session";

type Row = [string, string];

const MAP: Row[] = [
  ["drag, wheel, pinch", "move and zoom the map"], ["← ↑ → ↓, + −", "the same by keys; Shift goes further"], ["0", "show everything"], ["click, [ ]", "choose an agent: what it sees, its partners"],
  ["Esc", "choose none"],
];
const SHOW: Row[] = [["v", "fields of view"], ["3", "3-D view"], ["d", "dark or light"], ["#projector", "in the address: the map alone, for a projector"], ["?", "this list"]];
const RECORD: Row[] = [["space", "play or pause"], [", .", "one event back or on"], ["p n", "trade before, next trade"], ["< >", "slower, faster"], ["Home End", "start, end"]];
const STEER: Row[] = [["space", "pause or go on"], [".", "one step"], ["k", "kill or revive the chosen agent"], ["w", "drag weights of landmarks"], ["o", "put obstacles"]];
const SIGNS: Row[] = [
  ["cell", "a landmark in its owner's colour, with the owner's number where there is room; paler where it is worth less"], ["white", "offered in a trade at this moment"], ["dot and arrows", "an agent; the line is where its camera looks"],
  ["outline ahead", "where it sees at least half as well as it can"], ["ring", "waypoint of a vehicle on its way"], ["red ×", "dead"], ["dashed ring", "not heard for a while"],
];

export function showHelp(session: Session): void {
  const dialog = element<HTMLDialogElement>("help");
  const list = (rows: Row[]): HTMLElement =>
    make("dl", {}, ...rows.flatMap(([key, what]) => [make("dt", {}, make("kbd", {}, key)), make("dd", {}, what)]));
  const parts = [make("h3", {}, "Map"), list(MAP), make("h3", {}, "View"), list(SHOW)];
  if (session.replay) parts.push(make("h3", {}, "Record"), list(RECORD));
  if (session.hello?.may_steer) parts.push(make("h3", {}, "Run"), list(STEER));
  parts.push(make("h3", {}, "Signs"), make("dl", {}, ...SIGNS.flatMap(([sign, what]) => [make("dt", {}, sign), make("dd", {}, what)])));
  const close = button("×", "Close (Esc)", () => dialog.close());
  close.classList.add("close");
  dialog.setAttribute("aria-label", "Keys and signs");
  dialog.replaceChildren(close, ...parts);
  dialog.showModal();
}
