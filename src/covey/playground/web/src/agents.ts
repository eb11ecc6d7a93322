// The agents as the thesis draws them: a black dot between two round arrows, and a line the way the camera points.

import { inkOn, withAlpha, type Inks } from "./colour";
import { Activity, POSE } from "./messages";
import { shownPose, yawOf, type State, type World } from "./state";
import type { View } from "./view";
import { fieldOfView } from "./visibility";

function arrow(): Path2D {
  const path = new Path2D();
  const [from, to] = [(40 * Math.PI) / 180, (165 * Math.PI) / 180];
  for (const side of [1, -1]) {
    path.moveTo(Math.cos(from), side * Math.sin(from));
    path.arc(0, 0, 1, side * from, side * to, side < 0);
  }
  return path;
}

function tips(): Path2D {
  const path = new Path2D();
  const angle = (40 * Math.PI) / 180;
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  for (const side of [1, -1]) {
    path.moveTo(c + 0.62 * s, side * (s - 0.62 * c));
    path.lineTo(1.36 * c, side * 1.36 * s);
    path.lineTo(0.64 * c, side * 0.64 * s);
    path.closePath();
  }
  return path;
}

function line(): Path2D {
  const path = new Path2D();
  path.moveTo(0, 0);
  path.lineTo(2, 0);
  return path;
}

const ARCS = arrow();
const TIPS = tips();
const HEADING = line();
const BADGE_TURNS = [0, 35, -35, 70, -70, 105, -105];

/** Radius of the round arrows, CSS pixels. */
export function markRadius(m: number): number {
  return m <= 8 ? 13 : m <= 16 ? 10.5 : m <= 32 ? 8.5 : 6.5;
}

export interface AgentLook {
  selected: number;
  hovered: number;
  fields: boolean;
  dark: boolean;
}

export class Agents {
  private readonly fields: (Path2D | null)[];
  private readonly marks = new Map<string, OffscreenCanvas>();
  private readonly badges = new Map<string, OffscreenCanvas>();

  constructor(private readonly world: World) {
    this.fields = world.scene.agents.map((_, agent) => fieldOfView(world, agent));
  }

  draw(context: CanvasRenderingContext2D, ratio: number, view: View, state: State, partners: [number, number][], look: AgentLook, inks: Inks, font: string): void {
    const { m } = this.world;
    const places: { x: number; y: number; yaw: number }[] = [];
    for (let agent = 0; agent < m; agent++) {
      const pose = shownPose(state, agent);
      places.push({ x: view.x(pose[0]), y: view.y(pose[1]), yaw: yawOf(pose) });
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, view.width, view.height);
    context.save();
    context.beginPath();
    context.rect(view.frameLeft, 0, view.width, view.frameBottom);
    context.clip();
    for (let i = 0; i + 2 < state.objects.length; i += 3) {
      context.beginPath();
      context.arc(view.x(state.objects[i]), view.y(state.objects[i + 1]), Math.max(5, 0.25 * view.scale), 0, 2 * Math.PI);
      context.fillStyle = withAlpha(inks.faint, 0.6);
      context.fill();
      context.strokeStyle = inks.ink;
      context.lineWidth = 1.2;
      context.stroke();
    }
    this.drawFields(context, ratio, view, state, look, inks);
    if (look.selected >= 0) this.drawPartners(context, places, look.selected, partners, inks);
    if (state.flown) this.drawWaypoints(context, view, state, places, inks);
    const radius = markRadius(m);
    for (let agent = 0; agent < m; agent++) {
      if (state.activity[agent] === Activity.GONE) continue;
      const { x, y } = places[agent];
      if (x < -40 || y < -40 || x > view.width + 40 || y > view.height + 40) continue;
      this.drawMark(context, ratio, view, state, agent, places[agent], radius, look, inks);
    }
    this.drawBadges(context, ratio, view, state, places, radius, font);
    context.restore();
  }

  /** The agent at a place on the screen, or -1. */
  at(view: View, state: State, x: number, y: number, reach: number): number {
    let [best, found] = [reach, -1];
    for (let agent = 0; agent < this.world.m; agent++) {
      if (state.activity[agent] === Activity.GONE) continue;
      const pose = shownPose(state, agent);
      const away = Math.hypot(view.x(pose[0]) - x, view.y(pose[1]) - y);
      if (away < best) [best, found] = [away, agent];
    }
    return found;
  }

  private drawFields(context: CanvasRenderingContext2D, ratio: number, view: View, state: State, look: AgentLook, inks: Inks): void {
    for (let agent = 0; agent < this.world.m; agent++) {
      const field = this.fields[agent];
      const chosen = agent === look.selected || agent === look.hovered;
      if (!field || !(look.fields || chosen) || state.activity[agent] >= Activity.DEAD) continue;
      const pose = shownPose(state, agent);
      const yaw = yawOf(pose);
      const s = view.scale * ratio;
      context.setTransform(s * Math.cos(yaw), -s * Math.sin(yaw), -s * Math.sin(yaw), -s * Math.cos(yaw), ratio * view.x(pose[0]), ratio * view.y(pose[1]));
      if (agent === look.hovered && look.selected < 0) {
        context.fillStyle = "rgba(255,255,255,0.22)";
        context.fill(field, "evenodd");
      }
      context.lineWidth = (chosen ? 3.4 : 2.4) / view.scale;
      context.strokeStyle = withAlpha(inks.paper, 0.6);
      context.stroke(field);
      context.lineWidth = (chosen ? 1.8 : 1) / view.scale;
      context.strokeStyle = chosen ? inks.ink : withAlpha(inks.ink, 0.7);
      context.stroke(field);
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
  }

  private drawPartners(
    context: CanvasRenderingContext2D, places: { x: number; y: number }[], selected: number, partners: [number, number][], inks: Inks,
  ): void {
    const most = Math.max(1, ...partners.map(([, count]) => count));
    const from = places[selected];
    for (const [partner, count] of partners) {
      const to = places[partner];
      for (const [colour, extra] of [[inks.paper, 3], [inks.ink, 0]] as const) {
        context.beginPath();
        context.moveTo(from.x, from.y);
        context.lineTo(to.x, to.y);
        context.strokeStyle = colour;
        context.lineWidth = 1.2 + (3.5 * count) / most + extra;
        context.stroke();
      }
    }
  }

  private drawWaypoints(context: CanvasRenderingContext2D, view: View, state: State, places: { x: number; y: number }[], inks: Inks): void {
    for (let agent = 0; agent < this.world.m; agent++) {
      if (state.activity[agent] >= Activity.DEAD) continue;
      const [x, y] = [view.x(state.poses[agent * POSE]), view.y(state.poses[agent * POSE + 1])];
      const from = places[agent];
      if (Math.hypot(x - from.x, y - from.y) < 6) continue;
      const yaw = yawOf(state.poses.subarray(agent * POSE, (agent + 1) * POSE));
      context.setLineDash([4, 4]);
      context.beginPath();
      context.moveTo(from.x, from.y);
      context.lineTo(x, y);
      context.strokeStyle = inks.ink;
      context.lineWidth = 1.2;
      context.stroke();
      context.setLineDash([]);
      for (const [colour, width] of [[inks.paper, 5], [inks.ink, 3.4], [this.world.colours[agent], 2]] as const) {
        context.beginPath();
        context.arc(x, y, 7, 0, 2 * Math.PI);
        context.moveTo(x + 7 * Math.cos(yaw), y - 7 * Math.sin(yaw));
        context.lineTo(x + 13 * Math.cos(yaw), y - 13 * Math.sin(yaw));
        context.strokeStyle = colour;
        context.lineWidth = width;
        context.stroke();
      }
    }
  }

  private drawMark(
    context: CanvasRenderingContext2D, ratio: number, view: View, state: State, agent: number,
    place: { x: number; y: number; yaw: number }, radius: number, look: AgentLook, inks: Inks,
  ): void {
    const { x, y, yaw } = place;
    const activity = state.activity[agent];
    if (agent === look.selected || agent === look.hovered) {
      context.beginPath();
      context.arc(x, y, radius * 1.75, 0, 2 * Math.PI);
      context.fillStyle = "rgba(255,255,255,0.55)";
      context.fill();
      context.strokeStyle = agent === look.selected ? inks.accent : "#1a1a1a";
      context.lineWidth = agent === look.selected ? 2.5 : 1.2;
      context.stroke();
    }
    const body = this.world.scene.body_radius * view.scale;
    if (body > radius * 1.3) {
      context.beginPath();
      context.arc(x, y, body, 0, 2 * Math.PI);
      context.strokeStyle = withAlpha("#1a1a1a", 0.5);
      context.lineWidth = 1;
      context.stroke();
    }
    const sprite = this.mark(radius, ratio, activity === Activity.DEAD);
    const side = sprite.width / ratio;
    const [c, s] = [Math.cos(yaw) * ratio, Math.sin(yaw) * ratio];
    context.setTransform(c, -s, s, c, x * ratio, y * ratio);
    context.drawImage(sprite, -side / 2, -side / 2, side, side);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    if (activity === Activity.DEAD || activity === Activity.SUSPECT) {
      const d = radius * 1.2;
      for (const [colour, width] of [["#ffffff", 5], [activity === Activity.DEAD ? "#c1121f" : "#8a5a00", 2.6]] as const) {
        context.beginPath();
        if (activity === Activity.DEAD) {
          context.moveTo(x - d, y - d);
          context.lineTo(x + d, y + d);
          context.moveTo(x - d, y + d);
          context.lineTo(x + d, y - d);
        } else {
          context.arc(x, y, d * 1.3, 0, 2 * Math.PI);
          context.setLineDash([5, 4]);
        }
        context.strokeStyle = colour;
        context.lineWidth = width;
        context.stroke();
        context.setLineDash([]);
      }
    }
  }

  /** A pose mark that looks along x, drawn once. */
  private mark(radius: number, ratio: number, dead: boolean): OffscreenCanvas {
    const key = `${radius} ${ratio} ${dead}`;
    let sprite = this.marks.get(key);
    if (sprite) return sprite;
    const side = Math.ceil(2 * ratio * (2 * radius + 4));
    sprite = new OffscreenCanvas(side, side);
    const context = sprite.getContext("2d");
    if (context) {
      const s = radius * ratio;
      context.setTransform(s, 0, 0, s, side / 2, side / 2);
      context.lineCap = "round";
      context.lineJoin = "round";
      const thin = Math.max(1.3, 0.17 * radius) / radius;
      const dot = new Path2D();
      dot.arc(0, 0, 0.36, 0, 2 * Math.PI);
      for (const [ink, extra] of [["#ffffff", 2.6 / radius], [dead ? "#6b6b6b" : "#000000", 0]] as const) {
        context.strokeStyle = context.fillStyle = ink;
        context.lineWidth = thin + extra;
        context.stroke(ARCS);
        context.lineWidth = thin * 1.25 + extra;
        context.stroke(HEADING);
        context.lineWidth = extra || 0.01;
        context.fill(TIPS);
        context.stroke(TIPS);
        context.fill(dot);
        context.stroke(dot);
      }
    }
    this.marks.set(key, sprite);
    return sprite;
  }

  /** Numbers on discs of the agents' colours, behind their cameras or where there is room on the map. */
  private drawBadges(
    context: CanvasRenderingContext2D, ratio: number, view: View, state: State, places: { x: number; y: number; yaw: number }[], radius: number,
    font: string,
  ): void {
    const size = Math.max(7, 0.72 * radius);
    const shown = places.map((place, agent) => state.activity[agent] !== Activity.GONE && place.x > -50 && place.y > -50 && place.x < view.width + 50 && place.y < view.height + 50);
    const put: { x: number; y: number }[] = [];
    const crowded = places.length > 40;
    for (let agent = 0; agent < places.length; agent++) {
      if (!shown[agent]) continue;
      const { x, y, yaw } = places[agent];
      let spot = { x, y };
      let best = -Infinity;
      for (const turn of crowded ? [0] : BADGE_TURNS) {
        const angle = yaw + Math.PI + (turn * Math.PI) / 180;
        const trial = { x: x + 2 * radius * Math.cos(angle), y: y - 2 * radius * Math.sin(angle) };
        let room = Math.min(trial.x - view.frameLeft, view.width - trial.x, trial.y, view.frameBottom - trial.y) - size - 1;
        if (!crowded) {
          for (let other = 0; other < places.length; other++) {
            if (other !== agent && shown[other]) room = Math.min(room, Math.hypot(places[other].x - trial.x, places[other].y - trial.y) - radius - size);
          }
          for (const other of put) room = Math.min(room, Math.hypot(other.x - trial.x, other.y - trial.y) - 2 * size);
        }
        if (room > best + 0.5) [best, spot] = [room, trial];
        if (best >= 0) break;
      }
      put.push(spot);
      const sprite = this.badge(agent, size, ratio, font);
      const side = sprite.width / ratio;
      context.drawImage(sprite, spot.x - side / 2, spot.y - side / 2, side, side);
    }
  }

  /** An agent's number on a disc of its colour, drawn once. */
  private badge(agent: number, size: number, ratio: number, font: string): OffscreenCanvas {
    const key = `${agent} ${size} ${ratio}`;
    let sprite = this.badges.get(key);
    if (sprite) return sprite;
    const text = String(agent + 1);
    const radius = text.length > 1 ? size * (0.9 + 0.2 * text.length) : size;
    const side = Math.ceil(2 * ratio * (radius + 1.5));
    sprite = new OffscreenCanvas(side, side);
    const context = sprite.getContext("2d");
    if (context) {
      const colour = this.world.colours[agent];
      context.setTransform(ratio, 0, 0, ratio, side / 2, side / 2);
      context.beginPath();
      context.arc(0, 0, radius, 0, 2 * Math.PI);
      context.fillStyle = colour;
      context.fill();
      context.strokeStyle = "#1a1a1a";
      context.lineWidth = 1.2;
      context.stroke();
      context.font = `600 ${Math.round(1.25 * size)}px ${font}`;
      context.textAlign = "center";
      context.textBaseline = "middle";
      context.fillStyle = inkOn(colour);
      context.fillText(text, 0, 0.5);
    }
    this.badges.set(key, sprite);
    return sprite;
  }
}
