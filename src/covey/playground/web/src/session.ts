// What the page shows at this moment, wherever it comes from: a run that goes on, or a record.

import type { Hello, Message, Motion, Scene, Steered, Update } from "./messages";
import { apply, copyState, Dirty, initialState, openWorld, teamScore, type State, type World } from "./state";
import { lastAtOrBefore, Timeline } from "./timeline";

export type Status = "connecting" | "open" | "lost" | "over" | "failed";

export class Session {
  world: World | null = null;
  state: State | null = null;
  timeline: Timeline | null = null;
  hello: Hello | null = null;
  steered: Steered | null = null;
  status: Status = "connecting";
  trouble = "";
  refused = "";
  /** Where on the time line the page is. */
  x = 0;
  /** Changes whenever the world does. */
  scenes = 0;
  readonly dirty = new Dirty();
  replay: Replay | null = null;
  private waiting: Motion | null = null;

  get score(): number {
    return this.state ? teamScore(this.state) : NaN;
  }

  /** Take a message of a run that goes on. */
  receive(message: Message): void {
    switch (message.type) {
      case "Hello":
        this.hello = message;
        return;
      case "Steered":
        this.steered = message;
        return;
      case "Refused":
        this.refused = message.text;
        return;
      case "HeatMap":
        return;
      case "Scene":
        this.openScene(message);
        return;
      case "History":
        this.timeline?.restore(message);
        this.x = this.timeline?.last ?? 0;
        return;
      case "Motion":
        this.waiting = message; // the newest wins; the frame that is drawn next takes it
        return;
      default:
        this.add(message);
    }
  }

  /** Take the newest motion, right before a frame is drawn. */
  takeMotion(): void {
    const motion = this.waiting;
    this.waiting = null;
    if (motion) this.add(motion);
  }

  private openScene(scene: Scene): void {
    const grown = this.world !== null && this.timeline !== null && this.world.scene.mission === scene.mission && scene.agents.length >= this.world.m && this.status === "open";
    this.world = openWorld(scene);
    this.state = initialState(this.world);
    this.waiting = null;
    if (grown) this.timeline?.grow(this.world);
    else this.timeline = new Timeline(this.world, true);
    this.dirty.all = true;
    this.scenes++;
    this.status = "open";
  }

  private add(update: Update): void {
    const { state, timeline } = this;
    if (!state || !timeline) return;
    apply(state, update, this.dirty);
    const x = timeline.place(update);
    timeline.note(x, update, state);
    this.x = x;
    if (update.type === "Ended") this.status = "over";
  }
}

interface Keyframe {
  index: number;
  world: World;
  state: State;
}

const KEYFRAME_EVERY = 200;
const KEYFRAME_BYTES = 200e6;

/** A whole record, in memory, at any moment of it. */
export class Replay {
  readonly xs: Float64Array;
  readonly end: number;
  readonly start: number;
  private readonly keyframes: Keyframe[] = [];
  private index = -1;

  constructor(
    private readonly session: Session,
    private readonly feed: (Scene | Update)[],
  ) {
    this.xs = new Float64Array(feed.length);
    this.read();
    const first = feed.findIndex((message) => message.type !== "Scene");
    this.start = first >= 0 ? this.xs[first] : 0;
    this.end = feed.length ? this.xs[feed.length - 1] : 0;
  }

  /** Go through all of it once: the time line, and the state now and then. */
  private read(): void {
    const dirty = new Dirty();
    let world: World | null = null;
    let state: State | null = null;
    let timeline: Timeline | null = null;
    let [since, every, x] = [0, KEYFRAME_EVERY, 0];
    this.feed.forEach((message, index) => {
      if (message.type === "Scene") {
        world = openWorld(message);
        state = initialState(world);
        if (timeline) timeline.grow(world);
        else timeline = new Timeline(world, false);
        const most = KEYFRAME_BYTES / (14 * world.n + 500 * world.m + 1);
        every = Math.max(KEYFRAME_EVERY, this.feed.length / most);
      } else if (world && state && timeline) {
        apply(state, message, dirty);
        dirty.clear();
        x = timeline.place(message);
        timeline.note(x, message, state);
      }
      this.xs[index] = x;
      if (world && state && (message.type === "Scene" || ++since >= every)) {
        this.keyframes.push({ index, world, state: copyState(state) });
        since = 0;
      }
    });
    this.session.timeline = timeline;
    this.session.status = "open";
  }

  /** Show the state at a place on the time line. */
  seek(x: number): void {
    const { session } = this;
    const target = Math.max(lastAtOrBefore(this.xs, x), Math.min(0, this.feed.length - 1));
    session.x = Math.min(Math.max(x, this.start), this.end);
    if (target === this.index) return;
    const frame = lastKeyframe(this.keyframes, target);
    if (!frame) return;
    if (target < this.index || frame.index > this.index || !session.state) {
      if (session.world !== frame.world) {
        session.world = frame.world;
        session.scenes++;
      }
      session.state = copyState(frame.state);
      session.dirty.all = true;
      this.index = frame.index;
    }
    let motion: Motion | null = null;
    while (this.index < target) {
      const message = this.feed[++this.index];
      if (message.type === "Scene") {
        session.world = openWorld(message);
        session.state = initialState(session.world);
        session.dirty.all = true;
        session.scenes++;
        motion = null;
      } else if (message.type === "Motion") {
        motion = message;
      } else if (session.state) {
        apply(session.state, message, session.dirty);
      }
    }
    if (motion && session.state) apply(session.state, motion, session.dirty);
  }

  /** The place of the next update after x that is one of these, or of the last before it. */
  find(x: number, direction: 1 | -1, wanted: (message: Scene | Update) => boolean): number {
    if (direction > 0) {
      for (let i = lastAtOrBefore(this.xs, x) + 1; i < this.feed.length; i++) if (wanted(this.feed[i])) return this.xs[i];
      return this.end;
    }
    for (let i = lastAtOrBefore(this.xs, x); i >= 0; i--) if (this.xs[i] < x - 1e-9 && wanted(this.feed[i])) return this.xs[i];
    return this.start;
  }
}

function lastKeyframe(frames: Keyframe[], index: number): Keyframe | null {
  let [low, high] = [0, frames.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (frames[middle].index <= index) low = middle + 1;
    else high = middle;
  }
  return frames[low - 1] ?? null;
}

export function isChange(message: Scene | Update): boolean {
  return message.type === "TeamChange" || message.type === "Trading";
}

export function isTrade(message: Scene | Update): boolean {
  return message.type === "TeamChange" && message.kind === "trade";
}
