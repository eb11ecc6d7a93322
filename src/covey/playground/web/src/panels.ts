// The texts beside the map: head, table of agents, the chosen agent, and the log.

import { inkOn } from "./colour";
import { button, clock, element, make, number, percent, setText } from "./dom";
import { Activity, type Command } from "./messages";
import type { Session } from "./session";
import { signMark } from "./signs";
import type { State, World } from "./state";
import type { Entry } from "./timeline";

const LOG_SHOWN = 100;
const STATES: [string, string][] = [
  ["idle", "·"], ["asking", "?"], ["offering", "↔"], ["flying", "➤"], ["at rest", "✓"], ["not heard", "!"], ["dead", "✕"], ["absent", "–"],
];
const STATE_NAMES = Object.keys(Activity);

export function badge(world: World, agent: number): HTMLElement {
  const made = make("span", { class: "badge" }, String(agent + 1));
  made.style.background = world.colours[agent];
  made.style.color = inkOn(world.colours[agent]);
  return made;
}

function stateMark(activity: number): HTMLElement {
  const [label, sign] = STATES[activity] ?? ["?", "?"];
  return make("span", { class: "state", "data-state": STATE_NAMES[activity] ?? "" }, make("i", {}, sign), label);
}

function speedOf(state: State, agent: number): number {
  return state.velocities ? Math.hypot(...state.velocities.subarray(3 * agent, 3 * agent + 3)) : NaN;
}

interface Column {
  key: string;
  head: string;
  title: string;
  shown: (state: State) => boolean;
  text: (state: State, agent: number, counts: Int32Array) => string;
}

const COLUMNS: Column[] = [
  { key: "landmarks", head: "owns", title: "landmarks that it watches", shown: (s) => s.owner.length > 0, text: (_s, a, counts) => String(counts[a]) },
  { key: "score", head: "score", title: "its share of the team score", shown: (s) => s.owner.length > 0, text: (s, a) => number(s.scores[a], 2) },
  { key: "speed", head: "m/s", title: "speed", shown: (s) => s.velocities !== null, text: (s, a) => number(speedOf(s, a), 1) },
  { key: "battery", head: "battery", title: "what is left of its battery", shown: (s) => s.battery !== null, text: (s, a) => percent(s.battery?.[a] ?? NaN) },
  { key: "link", head: "link", title: "share of what was sent to it that arrived", shown: (s) => s.link !== null, text: (s, a) => percent(s.link?.[a] ?? NaN) },
  { key: "heard", head: "heard", title: "how long ago it was last heard", shown: (s) => s.heard !== null,
    text: (s, a) => (s.heard && Number.isFinite(s.heard[a]) ? `${Math.max(0, s.time - s.heard[a]).toFixed(1)} s` : "–") },
];

export class Panels {
  private scenes = -1;
  private columns = "";
  private rows: { row: HTMLTableRowElement; cells: HTMLElement[]; activity: number }[] = [];
  private logKey = "";
  private logNewest: Entry | null = null;
  private cardKey = "";
  private headKey = "";
  private readonly onlyTrades = element<HTMLInputElement>("only-trades");

  constructor(
    private readonly choose: (agent: number) => void,
    private readonly send: (command: Command) => void,
  ) {}

  update(session: Session, selected: number): void {
    this.updateHead(session);
    const { world, state } = session;
    if (!world || !state) return;
    const counts = new Int32Array(world.m);
    for (const owner of state.owner) if (owner >= 0) counts[owner]++;
    this.updateTable(session, world, state, counts, selected);
    this.updateCard(session, world, state, counts, selected);
    this.updateLog(session, world);
  }

  private updateHead(session: Session): void {
    const { world, state, timeline } = session;
    const [kind, text] = statusOf(session);
    const status = element("status");
    status.dataset.kind = kind;
    setText(status, text);
    if (!world || !state || !timeline) return;
    const { scene } = world;
    if (this.headKey !== scene.mission) {
      this.headKey = scene.mission;
      setText(element("mission"), scene.mission);
      document.title = `${scene.mission} · covey`;
    }
    const plural = (count: number, word: string): string => `${count} ${word}${count === 1 ? "" : "s"}`;
    const trading = world.n ? `${plural(world.n, "landmark")}, ${scene.trade} trade, σ ${scene.sigma}, ` : "";
    setText(element("subtitle"), `${plural(world.m, "agent")}, ${trading}seed ${scene.seed}`);
    document.body.classList.toggle("bare", world.n === 0); // vehicles with tasks of their own: nothing to score or trade
    const { score } = session;
    setText(element("score"), number(score, 2));
    element("bound-box").hidden = !Number.isFinite(state.bound);
    const share = score / state.bound;
    element("bound").replaceChildren(number(state.bound, 2), make("small", {}, ` ${number(100 * share, 1)} %`));
    setText(element("trades"), String(state.trades));
    setText(element("time-label"), timeline.byEvents ? "events" : "time");
    setText(element("time"), timeline.byEvents ? String(Math.round(session.x)) : clock(session.replay ? session.x : state.time));
  }

  private updateTable(session: Session, world: World, state: State, counts: Int32Array, selected: number): void {
    const columns = COLUMNS.filter((column) => column.shown(state));
    const key = columns.map((column) => column.key).join();
    if (this.scenes !== session.scenes || key !== this.columns) {
      this.scenes = session.scenes;
      this.columns = key;
      this.buildTable(world, columns);
    }
    this.rows.forEach((entry, agent) => {
      const { row, cells } = entry;
      row.setAttribute("aria-selected", String(agent === selected));
      if (entry.activity !== state.activity[agent]) {
        entry.activity = state.activity[agent];
        cells[0].replaceChildren(stateMark(entry.activity));
      }
      columns.forEach((column, i) => setText(cells[i + 1], column.text(state, agent, counts)));
    });
  }

  private buildTable(world: World, columns: Column[]): void {
    const table = element<HTMLTableElement>("agents");
    const heads = [make("th", { scope: "col", class: "text" }, "#"), make("th", { scope: "col", class: "text" }, "name"), make("th", { scope: "col", class: "text" }, "state")];
    const more = columns.map((column) => make("th", { scope: "col", title: column.title }, column.head));
    table.tHead?.replaceChildren(make("tr", {}, ...heads, ...more));
    this.rows = world.names.map((name, agent) => {
      const cells = [make("td", { class: "text" }), ...columns.map(() => make("td"))];
      const row = make("tr", { tabindex: "0", "data-agent": String(agent) }, make("td", { class: "text" }, badge(world, agent)), make("td", { class: "text", title: name }, name), ...cells);
      row.addEventListener("click", () => this.choose(agent));
      row.addEventListener("keydown", (event) => {
        if (event.key !== "Enter" && event.key !== " ") return;
        event.preventDefault();
        event.stopPropagation();
        this.choose(agent);
      });
      return { row, cells, activity: -1 };
    });
    table.tBodies[0].replaceChildren(...this.rows.map(({ row }) => row));
  }

  private updateCard(session: Session, world: World, state: State, counts: Int32Array, selected: number): void {
    const card = element("card");
    card.hidden = selected < 0 || selected >= world.m;
    if (card.hidden) {
      this.cardKey = "";
      return;
    }
    const partners = session.timeline?.partners(selected, session.x) ?? [];
    const pose = state.poses.subarray(7 * selected, 7 * selected + 7);
    const yaw = (Math.atan2(2 * (pose[3] * pose[6] + pose[4] * pose[5]), 1 - 2 * (pose[5] ** 2 + pose[6] ** 2)) * 180) / Math.PI;
    const where = `(${number(pose[0], 2)}, ${number(pose[1], 2)}${pose[2] ? `, ${number(pose[2], 2)}` : ""}) m, ${number(yaw, 0)}°`;
    const agent = world.scene.agents[selected];
    const reach = agent.optimal_distance === null ? "" : `, best at ${number(agent.optimal_distance, 2)} m`;
    const dead = state.activity[selected] === Activity.DEAD;
    const key = JSON.stringify([selected, partners, where, counts[selected], state.scores[selected], state.activity[selected], session.hello?.commands]);
    if (key === this.cardKey) return;
    this.cardKey = key;
    const may = (name: string): boolean => session.hello?.may_steer === true && session.hello.commands.includes(name);
    const head = make("div", { class: "head" }, badge(world, selected), make("strong", {}, world.names[selected]), stateMark(state.activity[selected]));
    if (!dead && may("kill")) head.append(button("Kill", "Let this agent fail (k)", () => this.send({ command: "kill", agent: selected })));
    if (dead && may("revive")) head.append(button("Revive", "Let this agent come back (k)", () => this.send({ command: "revive", agent: selected })));
    head.append(button("×", "Choose none (Esc)", () => this.choose(-1)));
    const list = make("div", { class: "partners" });
    for (const [partner, count] of partners.slice(0, 12)) list.append(make("span", {}, badge(world, partner), `${world.names[partner]} ×${count}`));
    if (partners.length > 12) list.append(make("span", {}, `and ${partners.length - 12} more`));
    if (!partners.length) list.append("nobody yet");
    card.replaceChildren(head, make("dl", {},
      make("dt", {}, "waypoint"), make("dd", {}, where),
      make("dt", {}, "sensor"), make("dd", {}, `${agent.sensor}${reach}`),
      make("dt", {}, "watches"), make("dd", {}, `${counts[selected]} landmarks, score ${number(state.scores[selected], 2)}`),
      make("dt", {}, "traded with"), make("dd", {}, list)));
  }

  private updateLog(session: Session, world: World): void {
    const { timeline } = session;
    if (!timeline) return;
    const count = timeline.entriesUpTo(session.x);
    const newest = timeline.entries[count - 1] ?? null;
    const key = `${this.onlyTrades.checked} ${session.scenes}`;
    if (newest === this.logNewest && key === this.logKey) return;
    const log = element("log");
    const known = key === this.logKey && this.logNewest ? timeline.entries.lastIndexOf(this.logNewest, count - 1) : -1;
    const rows: HTMLElement[] = [];
    for (let i = count - 1; i > known && rows.length < LOG_SHOWN; i--) {
      const entry = timeline.entries[i];
      if (this.onlyTrades.checked && entry.kind !== "trade") continue;
      rows.push(this.logRow(world, entry, timeline.byEvents));
    }
    this.logKey = key;
    this.logNewest = newest;
    if (known >= 0) {
      // Only what is new, since laying out a long list anew takes longer than drawing the map.
      if (rows.length) log.querySelector(".empty")?.remove();
      log.prepend(...rows);
      while (log.childElementCount > LOG_SHOWN) log.lastElementChild?.remove();
      return;
    }
    if (!rows.length) rows.push(make("li", { class: "empty" }, this.onlyTrades.checked ? "No trade yet." : "Nothing has happened yet."));
    log.replaceChildren(...rows);
  }

  private logRow(world: World, entry: Entry, byEvents: boolean): HTMLElement {
    const who = make("span", { class: "who" }, ...entry.agents.filter((agent) => agent >= 0 && agent < world.m).map((agent) => badge(world, agent)));
    const gain = Number.isFinite(entry.gain) && Math.abs(entry.gain) >= 0.005
      ? make("span", { class: entry.gain < 0 ? "gain loss" : "gain" }, `${entry.gain < 0 ? "−" : "+"}${Math.abs(entry.gain).toFixed(2)}`) : null;
    return make("li", { "data-kind": entry.kind },
      make("span", { class: "when" }, byEvents ? String(entry.x) : clock(entry.time)), signMark(entry.kind), make("span", {}, entry.agents.length ? who : null, withoutScore(entry.text) || entry.kind), gain);
  }
}

/** The score after a change is on the curve, and the gain beside the text. */
function withoutScore(text: string): string {
  return text.replace(/;? ?score [\d.]+$/, "");
}

function statusOf(session: Session): [string, string] {
  if (session.status === "failed") return ["lost", "no mission"];
  if (session.status === "lost") return ["lost", "connection lost, trying again …"];
  if (session.status === "connecting") return ["", "connecting …"];
  const ended = session.state?.ended;
  const end = ended ? `${ended.status}${ended.holds === null ? "" : ended.holds ? ", certificate holds" : ", certificate does not hold"}` : "";
  if (session.replay) return [end ? "over" : "", end || "record"];
  if (session.status === "over") return ["over", end || "over"];
  if (session.steered?.paused) return ["paused", "paused"];
  return ["live", "live"];
}
