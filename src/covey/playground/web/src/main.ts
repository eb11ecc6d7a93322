// Puts the page together: one session, drawn once a frame when something has changed.

import { Controls } from "./controls";
import { Chart } from "./chart";
import { element, make, memory } from "./dom";
import { showHelp } from "./help";
import { Interaction } from "./interact";
import { describe, WorldMap, type Selection } from "./map";
import { Activity, type Command, type HeatMap } from "./messages";
import { Panels } from "./panels";
import { Projector } from "./projector";
import type * as Scene3d from "./scene3d";
import { Player } from "./scrub";
import { Session } from "./session";
import { open } from "./source";
import { knowsSensor } from "./visibility";
import { bytes, values } from "./wire";

const PANELS_EVERY = 200;
const NOTICE_FOR = 5000;
const OBSTACLE_RADIUS = 0.3;
const OBSTACLE_HEIGHT = 3;

declare global {
  interface Window {
    coveyScene3d?: typeof Scene3d;
    covey: object;
  }
}

const session = new Session();
const frame = element("map");
const selection: Selection = { agent: -1, hovered: -1, fields: true, seen: null };
let stale = true;
let panelsAt = 0;
let panelsStale = true;
let view3d: Scene3d.View3d | null = null;
let frames = 0;

const redraw = (): void => {
  stale = true;
};
const changed = (): void => {
  stale = panelsStale = true;
};

applyTheme(memory.get("theme"));
const steering = open(session, changed);
const send = (command: Command): void => steering.send(command);
const map = new WorldMap(frame, false);
const projector = new Projector(session);
const player = new Player(session, changed);
const panels = new Panels(choose, send);
const chart = new Chart(element<HTMLCanvasElement>("chart"), element("legend"), (x) => player.seek(x));
const interaction = new Interaction(frame, map, session, {
  choose,
  hover: (agent) => {
    if (agent !== selection.hovered) redraw();
    selection.hovered = agent;
  },
  weigh: (landmark, weight) => send({ command: "weight", landmark, weight }),
  obstruct: (x, y) => send({ command: "obstacle", x, y, radius: OBSTACLE_RADIUS, height: OBSTACLE_HEIGHT }),
  redraw,
});
const controls = new Controls(session, interaction, send);

function choose(agent: number): void {
  selection.agent = agent === selection.agent ? -1 : agent;
  changed();
  panelsAt = 0;
  selection.seen = null;
  askedFor = "";
  element("hint").hidden = selection.agent < 0;
  explainColours(true);
}

/** What the colours of the cells mean while an agent is chosen. */
function explainColours(known: boolean): void {
  const name = session.world?.names[selection.agent];
  if (name === undefined) return;
  const ramp = make("span", { class: "ramp" });
  const text = known ? [`what ${name} sees: 0`, ramp, "1"] : [`What ${name} sees is not known here: its sensor is a model of its own.`];
  element("hint").replaceChildren(...text);
}

/** For sensors that the page does not know itself: of whom, where, and among which landmarks it was asked last. */
let askedFor = "";

/** Ask the server what the chosen agent sees, if the page cannot tell and it is not known yet from where the agent is now. */
function askWhatIsSeen(): void {
  const { world, state } = session;
  const { agent } = selection;
  if (!world || !state || agent < 0 || agent >= world.m || knowsSensor(world, agent)) return;
  const key = `${agent} ${session.scenes} ${state.poses.subarray(7 * agent, 7 * agent + 7).join(" ")}`;
  if (key === askedFor) return;
  askedFor = key;
  void askHeatMap(agent, key);
}

async function askHeatMap(agent: number, key: string): Promise<void> {
  let visibility: Float32Array | null = null;
  if (!session.replay) {
    try {
      const response = await fetch(`api/heatmap?agent=${agent}`);
      if (response.ok) visibility = values(((await response.json()) as HeatMap).visibility);
    } catch {
      // said below
    }
  }
  if (key !== askedFor || selection.agent !== agent) return; // there is a newer question
  selection.seen = visibility && visibility.length === session.world?.n ? { agent, visibility } : null;
  explainColours(selection.seen !== null);
  changed();
}

function applyTheme(wanted: string | null): void {
  const system = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  document.documentElement.dataset.theme = wanted === "dark" || wanted === "light" ? wanted : system;
}

function themeChanged(): void {
  map.setTheme();
  view3d?.setTheme();
  panelsAt = 0;
  changed();
}

function toggleTheme(): void {
  const next = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  memory.set("theme", next);
  applyTheme(next);
  themeChanged();
}

function notice(text: string): void {
  const box = element("notice");
  box.textContent = text;
  box.hidden = false;
  setTimeout(() => (box.hidden = true), NOTICE_FOR);
}

/** The second bundle, once. */
async function loadScene3d(): Promise<typeof Scene3d> {
  if (window.coveyScene3d) return window.coveyScene3d;
  const script = document.createElement("script");
  const embedded = document.getElementById("covey-scene3d");
  const loaded = new Promise<void>((resolve, reject) => {
    script.onload = () => resolve();
    script.onerror = () => reject(new Error("scene3d.js cannot be loaded"));
  });
  if (embedded) script.textContent = new TextDecoder().decode(bytes((embedded.textContent ?? "").trim()));
  else script.src = "scene3d.js";
  document.head.append(script);
  if (!embedded) await loaded;
  if (!window.coveyScene3d) throw new Error("scene3d.js cannot be loaded");
  return window.coveyScene3d;
}

async function toggle3d(): Promise<void> {
  const host = element("scene3d");
  const toggle = element<HTMLButtonElement>("view3d");
  if (!host.hidden) {
    host.hidden = true;
    frame.hidden = false;
    session.dirty.all = true;
  } else {
    try {
      const scene3d = await loadScene3d();
      if (!scene3d.available()) {
        notice("This browser has no WebGL, so there is no 3-D view here; the map shows the same.");
        return;
      }
      view3d ??= new scene3d.View3d(host);
    } catch (error) {
      notice(`No 3-D view: ${error instanceof Error ? error.message : String(error)}.`);
      return;
    }
    host.hidden = false;
    frame.hidden = true;
    element("tip").hidden = true;
    session.dirty.all = true;
  }
  toggle.setAttribute("aria-pressed", String(!host.hidden));
  changed();
}

/** Of many agents at once they would hide the map. */
const FIELDS_UP_TO = 12;
let fieldsChosen = false;

function showFields(shown: boolean): void {
  if (shown === selection.fields) return;
  selection.fields = shown;
  element("fields").setAttribute("aria-pressed", String(selection.fields));
  redraw();
}

function toggleFields(): void {
  fieldsChosen = true;
  showFields(!selection.fields);
}

function showCover(): void {
  const cover = element("cover");
  cover.hidden = session.world !== null && session.state !== null;
  cover.classList.toggle("failed", session.status === "failed");
  if (session.status === "failed") {
    element("cover-text").textContent = "Nothing to show";
    element("cover-detail").textContent = session.trouble;
  } else {
    element("cover-detail").textContent = session.hello?.source === "record" ? "Reading the record …" : "The page goes on by itself as soon as it hears of one.";
  }
}

function drawFrame(now: number): void {
  requestAnimationFrame(drawFrame);
  session.takeMotion();
  player.advance(now);
  if (session.refused) {
    notice(session.refused);
    session.refused = "";
  }
  const moving = session.x !== drawnX;
  drawnX = session.x;
  if (stale || moving || session.dirty.all || session.dirty.cells.length || map.unfinished) {
    stale = false;
    frames++;
    if (projector.active) projector.draw();
    else if (view3d && !element("scene3d").hidden) view3d.draw(session, true);
    else {
      map.draw(session, selection);
      interaction.refresh();
    }
    panelsStale = true;
  } else if (view3d && !element("scene3d").hidden) {
    view3d.draw(session, false);
  }
  if (panelsStale && !projector.active && now - panelsAt >= PANELS_EVERY) {
    panelsAt = now;
    panelsStale = false;
    if (!fieldsChosen && session.world) showFields(session.world.m <= FIELDS_UP_TO);
    showCover();
    askWhatIsSeen();
    panels.update(session, selection.agent);
    controls.update();
    chart.draw(session);
  }
}
let drawnX = NaN;

function fitFrame(): void {
  map.resize(frame.clientWidth, frame.clientHeight, Math.min(window.devicePixelRatio || 1, 2));
  changed();
}

function followAddress(): void {
  projector.toggle(new URLSearchParams(location.hash.slice(1)).has("projector"));
  session.dirty.all = true;
  changed();
}

function fitAll(): void {
  if (element("scene3d").hidden) map.view.refit();
  else view3d?.goHome();
  redraw();
}

function selectNext(by: 1 | -1): void {
  const m = session.world?.m ?? 0;
  if (m) choose(selection.agent < 0 ? (by > 0 ? 0 : m - 1) : (selection.agent + by + m) % m);
}

function killOrRevive(): void {
  const { agent } = selection;
  if (agent < 0 || !session.state) return;
  const command = session.state.activity[agent] === Activity.DEAD ? "revive" : "kill";
  if (controls.may(command)) send({ command, agent });
}

const KEYS: Record<string, () => void> = {
  "?": () => showHelp(session),
  "0": fitAll,
  d: toggleTheme,
  v: toggleFields,
  "3": () => void toggle3d(),
  "[": () => selectNext(-1),
  "]": () => selectNext(1),
  k: killOrRevive,
  w: () => controls.may("weight") && controls.toggleTool("weight"),
  o: () => controls.may("obstacle") && controls.toggleTool("obstacle"),
  " ": () => (session.replay ? player.togglePlaying() : controls.togglePause()),
  ".": () => (session.replay ? player.step(1) : controls.step()),
  ",": () => player.step(-1),
  n: () => player.jump(1),
  p: () => player.jump(-1),
  ">": () => player.faster(1),
  "<": () => player.faster(-1),
  Home: () => session.replay && player.seek(session.replay.start),
  End: () => session.replay && player.seek(session.replay.end),
  Escape: () => {
    if (interaction.tool !== "look") controls.toggleTool("look");
    else if (selection.agent >= 0) choose(selection.agent);
  },
};

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || element<HTMLDialogElement>("help").open) return;
  if (projector.active) {
    if (projector.key(event)) event.preventDefault();
    return;
  }
  if (event.altKey) return;
  const target = event.target as HTMLElement;
  const typing = target instanceof HTMLSelectElement || (target instanceof HTMLInputElement && target.type !== "checkbox");
  const arrows = event.key.startsWith("Arrow") || event.key === "Home" || event.key === "End";
  if (typing && (arrows || event.key === " ")) return;
  if (target instanceof HTMLButtonElement && (event.key === " " || event.key === "Enter")) return;
  if (arrows && event.key.startsWith("Arrow") && target !== frame && target !== document.body) return;
  if (element("scene3d").hidden && interaction.key(event)) event.preventDefault();
  else if (Object.hasOwn(KEYS, event.key)) {
    event.preventDefault();
    KEYS[event.key]();
  }
});

element("view3d").addEventListener("click", () => void toggle3d());
element("fields").addEventListener("click", toggleFields);
element("fit").addEventListener("click", fitAll);
element("theme").addEventListener("click", toggleTheme);
element("help-button").addEventListener("click", () => showHelp(session));
element("only-trades").addEventListener("change", changed);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  applyTheme(memory.get("theme"));
  themeChanged();
});
window.addEventListener("hashchange", followAddress);
new ResizeObserver(fitFrame).observe(frame);
new ResizeObserver(changed).observe(element("chart"));

window.covey = Object.freeze({
  state: () => describe(session, map),
  /** Where a point of frame W is on the page, CSS pixels. */
  locate: (x: number, y: number) => {
    const box = frame.getBoundingClientRect();
    return { x: box.left + map.view.x(x), y: box.top + map.view.y(y) };
  },
  frames: () => frames,
});

fitFrame();
followAddress();
requestAnimationFrame(drawFrame);
