// The player of a record: scrub bar, speed, steps, and jumps to the next trade.

import { button, clock, element, make, setText } from "./dom";
import { isChange, isTrade, type Replay, type Session } from "./session";
import { signOf } from "./signs";

const PLAY = "M6 3.5v13l10-6.5z";
const PAUSE = "M6.5 4v12M13.5 4v12";
const BACK = "M15.5 4v12l-8-6zM4.5 4v12";
const STEP = "M4.5 4v12l8-6zM15.5 4v12";
const NEXT = "M3 4.5 8.5 10 3 15.5M9 4.5l5.5 5.5L9 15.5M17 4v12";
const PREVIOUS = "M17 4.5 11.5 10l5.5 5.5M11 4.5 5.5 10l5.5 5.5M3 4v12";

/** Changes and offers a second at speed 1, where the time line counts those. */
const EVENTS_A_SECOND = 4;
const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];

export class Player {
  private readonly bar = element("player");
  private replay: Replay | null = null;
  private playing = false;
  private speed = 1;
  private before = 0;
  private slider: HTMLInputElement | null = null;
  private marks: HTMLCanvasElement | null = null;
  private toggle: HTMLButtonElement | null = null;
  private select: HTMLSelectElement | null = null;
  private readonly place = make("span", { id: "place" });
  private marksKey = "";

  constructor(
    private readonly session: Session,
    private readonly changed: () => void,
  ) {}

  /** Let time pass, right before a frame is drawn. */
  advance(now: number): void {
    const { replay } = this.session;
    if (replay && replay !== this.replay) this.build(replay);
    if (!replay) return;
    if (this.playing) {
      const seconds = Math.min((now - this.before) / 1000, 0.25);
      const rate = this.speed * (this.session.timeline?.byEvents ? EVENTS_A_SECOND : 1);
      replay.seek(this.session.x + seconds * rate);
      if (this.session.x >= replay.end) this.setPlaying(false);
      this.changed();
    }
    this.before = now;
    this.show(replay);
  }

  get isPlaying(): boolean {
    return this.playing;
  }

  seek(x: number): void {
    this.session.replay?.seek(x);
    this.changed();
  }

  togglePlaying(): void {
    const { replay } = this.session;
    if (!replay) return;
    if (!this.playing && this.session.x >= replay.end) replay.seek(replay.start);
    this.setPlaying(!this.playing);
    this.changed();
  }

  step(direction: 1 | -1): void {
    const { replay } = this.session;
    if (!replay) return;
    this.setPlaying(false);
    this.seek(replay.find(this.session.x, direction, isChange));
  }

  jump(direction: 1 | -1): void {
    const { replay } = this.session;
    if (replay) this.seek(replay.find(this.session.x, direction, isTrade));
  }

  faster(direction: 1 | -1): void {
    const at = SPEEDS.indexOf(this.speed);
    this.setSpeed(SPEEDS[Math.min(Math.max((at < 0 ? 2 : at) + direction, 0), SPEEDS.length - 1)]);
  }

  private setSpeed(speed: number): void {
    this.speed = speed;
    if (this.select) this.select.value = String(speed);
  }

  private setPlaying(playing: boolean): void {
    this.playing = playing;
    this.before = performance.now();
    this.toggle?.querySelector("path")?.setAttribute("d", playing ? PAUSE : PLAY);
    const label = this.toggle?.querySelector("span");
    if (label) label.textContent = playing ? "Pause" : "Play";
  }

  private build(replay: Replay): void {
    this.replay = replay;
    const byEvents = this.session.timeline?.byEvents ?? false;
    this.slider = make("input", {
      type: "range", id: "scrub-input", min: String(replay.start), max: String(replay.end), step: byEvents ? "1" : "any", "aria-label": byEvents ? "Event" : "Time",
    });
    this.slider.addEventListener("input", () => this.seek(Number(this.slider?.value)));
    this.marks = make("canvas");
    const wide = (made: HTMLButtonElement): HTMLButtonElement => (made.classList.add("wide"), made);
    this.toggle = button("Play", "Play or pause (space)", () => this.togglePlaying(), PLAY);
    this.select = make("select", { "aria-label": "Speed" }, ...SPEEDS.map((speed) => make("option", { value: String(speed) }, `${speed}×`)));
    this.select.addEventListener("change", () => this.setSpeed(Number(this.select?.value)));
    const given = this.session.hello?.speed ?? 1;
    if (!SPEEDS.includes(given)) this.select.append(make("option", { value: String(given) }, `${given}×`));
    this.setSpeed(given);
    this.bar.replaceChildren(
      this.toggle,
      wide(button("Back one event", "Back one event (,)", () => this.step(-1), BACK)),
      button("On one event", "On one event (.)", () => this.step(1), STEP),
      wide(button("Trade before", "Trade before (p)", () => this.jump(-1), PREVIOUS)),
      button("Next trade", "Next trade (n)", () => this.jump(1), NEXT),
      make("div", { id: "scrub" }, this.marks, this.slider),
      this.place,
      this.select,
    );
    this.bar.hidden = false;
  }

  private show(replay: Replay): void {
    const { session, slider } = this;
    if (!slider || !session.timeline) return;
    if (Number(slider.value) !== session.x) slider.value = String(session.x);
    const text = session.timeline.byEvents ? `event ${Math.round(session.x)} of ${replay.end}` : `${clock(session.x)} of ${clock(replay.end)}`;
    setText(this.place, text);
    slider.setAttribute("aria-valuetext", text);
    this.drawMarks(replay);
  }

  /** A tick at each event, under the bar. */
  private drawMarks(replay: Replay): void {
    const { marks, session } = this;
    if (!marks || !session.timeline) return;
    const [width, height] = [marks.clientWidth, marks.clientHeight];
    const ratio = window.devicePixelRatio || 1;
    const key = `${width} ${ratio} ${document.documentElement.dataset.theme}`;
    if (key === this.marksKey || width === 0) return;
    this.marksKey = key;
    marks.width = width * ratio;
    marks.height = height * ratio;
    const context = marks.getContext("2d");
    if (!context) return;
    context.scale(ratio, ratio);
    const style = getComputedStyle(document.documentElement);
    for (const entry of session.timeline.entries) {
      const sign = signOf(entry.kind);
      if (entry.kind !== "trade" && !sign.rare) continue;
      context.fillStyle = style.getPropertyValue(sign.colour);
      context.globalAlpha = sign.rare ? 1 : 0.55;
      const x = ((entry.x - replay.start) / Math.max(replay.end - replay.start, 1e-9)) * (width - 2);
      context.fillRect(x, sign.rare ? 0 : 3, sign.rare ? 2 : 1, height);
    }
  }
}
