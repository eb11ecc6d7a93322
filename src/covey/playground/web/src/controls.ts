// What a visitor with the token may do to a run; shown only as far as the run allows it.

import { button, element, make, percent } from "./dom";
import type { Interaction, Tool } from "./interact";
import type { Command, Run } from "./messages";
import type { Session } from "./session";

const PAUSE = "M6.5 4v12M13.5 4v12";
const PLAY = "M6 3.5v13l10-6.5z";
const STEP = "M4.5 4v12l8-6zM15.5 4v12";
const WEIGHT = "M10 3v14M6 6.5 10 3l4 3.5M6 13.5 10 17l4-3.5";
const OBSTACLE = "M4 16V7l6-3 6 3v9zM4 16 16 8.5M8 16.5 16 12";

const SPEEDS = { plan: [0, 1, 2, 5, 10, 30], flight: [0, 0.5, 1, 2, 5, 10], network: [0, 0.5, 1, 2, 5, 10] };

function speedName(run: Run, speed: number): string {
  if (speed === 0) return "full speed";
  return run === "plan" ? `${Number(speed.toFixed(1))} events/s` : `${Number(speed.toFixed(1))}×`;
}

export class Controls {
  private readonly bar = element("steering");
  private key = "";
  private pause: HTMLButtonElement | null = null;
  private loss: { input: HTMLInputElement; output: HTMLOutputElement } | null = null;
  private speed: HTMLSelectElement | null = null;
  private readonly tools = new Map<Tool, HTMLButtonElement>();

  constructor(
    private readonly session: Session,
    private readonly interaction: Interaction,
    private readonly send: (command: Command) => void,
  ) {}

  may(name: string): boolean {
    const { hello } = this.session;
    return hello !== null && hello.may_steer && hello.commands.includes(name);
  }

  update(): void {
    const { hello, world } = this.session;
    const over = this.session.status !== "open";
    const key = JSON.stringify([hello?.may_steer, hello?.commands, world?.scene.run, over]);
    if (key !== this.key && world) {
      this.key = key;
      this.build(over);
    }
    this.show();
  }

  togglePause(): void {
    if (this.may("pause")) this.send({ command: this.session.steered?.paused ? "resume" : "pause" });
  }

  step(): void {
    if (this.may("step")) this.send({ command: "step" });
  }

  toggleTool(tool: Tool): void {
    this.interaction.setTool(this.interaction.tool === tool ? "look" : tool);
    const hints: Record<Tool, string> = {
      look: "", weight: "Drag a landmark up to make it worth more, down for less.", obstacle: "Click where an obstacle of 0.3 m radius shall stand.",
    };
    const hint = element("hint");
    hint.textContent = hints[this.interaction.tool];
    hint.hidden = hint.textContent === "";
    this.show();
  }

  private build(over: boolean): void {
    const { world } = this.session;
    const parts: HTMLElement[] = [];
    this.tools.clear();
    this.pause = this.loss = this.speed = null;
    if (this.may("pause")) {
      this.pause = button("Pause", "Pause or go on (space)", () => this.togglePause(), PAUSE);
      parts.push(this.pause);
    }
    if (this.may("step")) parts.push(button("Step", "One step (.)", () => this.step(), STEP));
    if (this.may("speed")) {
      const run = world?.scene.run ?? "plan";
      this.speed = make("select", { "aria-label": "Speed", title: run === "plan" ? "Changes and offers a second" : "Simulated seconds a second" },
        ...SPEEDS[run].map((speed) => make("option", { value: String(speed) }, speedName(run, speed))));
      this.speed.addEventListener("change", () => this.send({ command: "speed", speed: Number(this.speed?.value) }));
      parts.push(this.speed);
    }
    if (this.may("loss")) {
      const input = make("input", { type: "range", min: "0", max: "0.9", step: "0.05", value: "0", "aria-label": "Share of the messages that are lost" });
      const output = make("output", {}, "0 %");
      input.addEventListener("input", () => (output.textContent = percent(Number(input.value))));
      input.addEventListener("change", () => this.send({ command: "loss", loss: Number(input.value) }));
      this.loss = { input, output };
      parts.push(make("span", { class: "rule" }), make("label", {}, "loss", input, output));
    }
    const tools: HTMLElement[] = [];
    if (this.may("weight")) tools.push(this.toolButton("weight", "Weight", "Drag the weight of a landmark (w)", WEIGHT));
    if (this.may("obstacle")) tools.push(this.toolButton("obstacle", "Obstacle", "Put an obstacle on the map (o)", OBSTACLE));
    if (tools.length) parts.push(make("span", { class: "rule" }), ...tools);
    this.bar.hidden = parts.length === 0 || over;
    this.bar.replaceChildren(...parts);
    if (over && this.interaction.tool !== "look") this.toggleTool("look");
  }

  private toolButton(tool: Tool, label: string, title: string, icon: string): HTMLButtonElement {
    const made = button(label, title, () => this.toggleTool(tool), icon);
    this.tools.set(tool, made);
    return made;
  }

  private show(): void {
    const { steered } = this.session;
    for (const [tool, made] of this.tools) made.setAttribute("aria-pressed", String(this.interaction.tool === tool));
    if (!steered) return;
    if (this.pause) {
      const label = steered.paused ? "Go on" : "Pause";
      if (this.pause.textContent !== label) {
        this.pause.querySelector("path")?.setAttribute("d", steered.paused ? PLAY : PAUSE);
        const text = this.pause.querySelector("span");
        if (text) text.textContent = label;
      }
    }
    if (this.speed && document.activeElement !== this.speed) {
      const value = String(steered.speed);
      if (![...this.speed.options].some((option) => option.value === value)) {
        this.speed.append(make("option", { value }, speedName(this.session.world?.scene.run ?? "plan", steered.speed)));
      }
      this.speed.value = value;
    }
    if (this.loss && document.activeElement !== this.loss.input) {
      this.loss.input.value = String(steered.loss);
      this.loss.output.textContent = percent(steered.loss);
    }
  }
}
