// Mouse, touch and keys on the map.

import { element, make, number } from "./dom";
import type { WorldMap } from "./map";
import { NOBODY } from "./messages";
import type { Session } from "./session";
import { visibilityOf } from "./visibility";

/** What a press on the map does. */
export type Tool = "look" | "weight" | "obstacle";

export interface Wishes {
  choose(agent: number): void;
  hover(agent: number): void;
  weigh(landmark: number, weight: number): void;
  obstruct(x: number, y: number): void;
  redraw(): void;
}

const CLICK = 5;
const PIXELS_TO_DOUBLE = 60;

export class Interaction {
  tool: Tool = "look";
  private readonly pointers = new Map<number, { x: number; y: number }>();
  private travelled = 0;
  private pinch = 0;
  private last: { x: number; y: number } | null = null;
  private weighing: { landmark: number; start: number; y: number; weight: number } | null = null;
  private readonly tip = element("tip");
  private tipKey = "";

  constructor(
    private readonly frame: HTMLElement,
    private readonly map: WorldMap,
    private readonly session: Session,
    private readonly wishes: Wishes,
  ) {
    frame.addEventListener("pointerdown", (event) => this.down(event));
    frame.addEventListener("pointermove", (event) => this.move(event));
    frame.addEventListener("pointerup", (event) => this.up(event));
    frame.addEventListener("pointercancel", (event) => this.up(event));
    frame.addEventListener("pointerleave", (event) => {
      if (event.pointerType !== "touch") this.leave(); // a finger leaves whenever it is lifted
    });
    frame.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    frame.addEventListener("dblclick", (event) => this.zoom(event.offsetX, event.offsetY, 2));
  }

  setTool(tool: Tool): void {
    this.tool = tool;
    this.frame.classList.remove("weight", "obstacle");
    if (tool !== "look") this.frame.classList.add(tool);
  }

  private place(event: PointerEvent): { x: number; y: number } {
    const box = this.frame.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  private down(event: PointerEvent): void {
    if (event.button !== 0) return;
    const place = this.place(event);
    this.frame.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, place);
    this.travelled = 0;
    if (event.pointerType === "touch") this.leave();
    const { world, state } = this.session;
    if (this.tool === "weight" && world && state && this.pointers.size === 1) {
      const landmark = this.map.landmarkAt(world, place.x, place.y);
      if (landmark >= 0) this.weighing = { landmark, start: state.weights[landmark] || 1, y: place.y, weight: state.weights[landmark] };
    }
    if (this.pointers.size === 2) this.pinch = this.spread();
  }

  private spread(): number {
    const [a, b] = [...this.pointers.values()];
    return Math.hypot(a.x - b.x, a.y - b.y);
  }

  private move(event: PointerEvent): void {
    const place = this.place(event);
    const before = this.pointers.get(event.pointerId);
    this.last = place;
    if (!before) {
      this.showTip(event.pointerType !== "touch");
      return;
    }
    this.pointers.set(event.pointerId, place);
    this.travelled += Math.hypot(place.x - before.x, place.y - before.y);
    if (this.weighing) {
      const doubled = (this.weighing.y - place.y) / PIXELS_TO_DOUBLE;
      this.weighing.weight = Math.round(this.weighing.start * 2 ** doubled * 100) / 100;
      this.showTip(true);
      return;
    }
    if (this.travelled < CLICK) return;
    this.frame.classList.add("dragging");
    this.tip.hidden = true;
    if (this.pointers.size === 2) {
      const spread = this.spread();
      const [a, b] = [...this.pointers.values()];
      this.map.view.pan((place.x - before.x) / 2, (place.y - before.y) / 2);
      if (this.pinch > 0) this.zoom((a.x + b.x) / 2, (a.y + b.y) / 2, spread / this.pinch);
      this.pinch = spread;
    } else {
      this.map.view.pan(place.x - before.x, place.y - before.y);
    }
    this.wishes.redraw();
  }

  private up(event: PointerEvent): void {
    const place = this.pointers.get(event.pointerId);
    if (!place) return;
    this.pointers.delete(event.pointerId);
    this.frame.classList.remove("dragging");
    const { weighing } = this;
    this.weighing = null;
    const { world, state } = this.session;
    if (!world || !state || event.type === "pointercancel") return;
    if (weighing) {
      if (weighing.weight !== state.weights[weighing.landmark]) this.wishes.weigh(weighing.landmark, weighing.weight);
      return;
    }
    if (this.travelled >= CLICK || this.pointers.size > 0) return;
    if (this.tool === "obstacle") {
      this.wishes.obstruct(this.map.view.worldX(place.x), this.map.view.worldY(place.y));
      return;
    }
    const touch = event.pointerType === "touch";
    this.wishes.choose(this.map.agentAt(state, place.x, place.y, touch ? 28 : 18));
    if (touch) {
      this.last = place;
      this.showTip(true);
    }
  }

  private leave(): void {
    this.last = null;
    this.tip.hidden = true;
    this.frame.classList.remove("on-agent");
    this.wishes.hover(-1);
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    const box = this.frame.getBoundingClientRect();
    this.zoom(event.clientX - box.left, event.clientY - box.top, Math.exp(-Math.max(-120, Math.min(120, event.deltaY * lines)) / 300));
  }

  private zoom(x: number, y: number, factor: number): void {
    this.map.view.zoomAt(x, y, factor);
    this.wishes.redraw();
  }

  /** Move or zoom by a key; whether the key meant that. */
  key(event: KeyboardEvent): boolean {
    const { view } = this.map;
    const far = event.shiftKey ? 200 : 50;
    const moves: Record<string, [number, number]> = { ArrowLeft: [far, 0], ArrowRight: [-far, 0], ArrowUp: [0, far], ArrowDown: [0, -far] };
    if (Object.hasOwn(moves, event.key)) view.pan(...moves[event.key]);
    else if (event.key === "+" || event.key === "=") view.zoomAt(view.width / 2, view.height / 2, 1.25);
    else if (event.key === "-") view.zoomAt(view.width / 2, view.height / 2, 0.8);
    else return false;
    this.wishes.redraw();
    return true;
  }

  /** The state has changed under the pointer. */
  refresh(): void {
    if (!this.tip.hidden && this.last) this.showTip(true);
  }

  private showTip(shown: boolean): void {
    const { world, state } = this.session;
    if (!shown || !world || !state || !this.last) {
      this.tip.hidden = true;
      return;
    }
    const { x, y } = this.last;
    const agent = this.weighing ? -1 : this.map.agentAt(state, x, y);
    this.wishes.hover(agent);
    this.frame.classList.toggle("on-agent", agent >= 0 && this.tool === "look");
    const landmark = this.weighing?.landmark ?? this.map.landmarkAt(world, x, y);
    if (agent < 0 && landmark < 0) {
      this.tip.hidden = true;
      return;
    }
    const lines = agent >= 0 ? this.agentLines(agent) : this.landmarkLines(landmark);
    const key = lines.join("\n");
    if (key !== this.tipKey) {
      this.tipKey = key;
      this.tip.replaceChildren(make("b", {}, lines[0]), ...lines.slice(1).map((text) => make("div", { class: "faint" }, text)));
    }
    this.tip.hidden = false;
    const [w, h] = [this.tip.offsetWidth, this.tip.offsetHeight];
    const left = x + 16 + w > this.frame.clientWidth ? x - w - 12 : x + 16;
    const top = y + 16 + h > this.frame.clientHeight ? y - h - 12 : y + 16;
    this.tip.style.left = `${Math.max(4, left)}px`;
    this.tip.style.top = `${Math.max(4, top)}px`;
  }

  private agentLines(agent: number): string[] {
    const { world, state } = this.session;
    if (!world || !state) return [];
    let count = 0;
    for (const owner of state.owner) if (owner === agent) count++;
    const pose = (state.flown ?? state.poses).subarray(7 * agent, 7 * agent + 3);
    return [`${agent + 1} ${world.names[agent]}`, `at (${number(pose[0], 2)}, ${number(pose[1], 2)}) m`, `${count} landmarks, score ${number(state.scores[agent], 2)}`, "click for what it sees and its partners"];
  }

  private landmarkLines(landmark: number): string[] {
    const { world, state } = this.session;
    if (!world || !state) return [];
    const owner = state.owner[landmark];
    const weight = this.weighing?.weight ?? state.weights[landmark];
    const [x, y, z] = world.positions.subarray(3 * landmark, 3 * landmark + 3);
    const lines = [`landmark ${landmark}`, `(${number(x, 2)}, ${number(y, 2)}${z ? `, ${number(z, 2)}` : ""}) m`];
    if (owner === NOBODY) lines.push("watched by nobody");
    else {
      const seen = visibilityOf(world, state, owner, landmark);
      lines.push(`watched by ${owner + 1} ${world.names[owner]}${Number.isNaN(seen) ? "" : `, visibility ${number(seen, 2)}`}`);
    }
    if (weight !== 1) lines.push(weight > 0 ? `weight ${number(weight, 2)}` : "removed");
    if (state.trading[landmark]) lines.push("offered in a trade");
    return lines;
  }
}
