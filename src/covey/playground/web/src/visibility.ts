// The built-in visibility models, as in `covey.sensing`.

import { POSE } from "./messages";
import { yawOf, type State, type World } from "./state";

type Model = (ahead: number, square: number, facing: number) => number;

const MODELS: Record<string, Model> = {
  anisotropic: (ahead, square) => Math.max(0, ahead) / Math.max(1, square),
  isotropic: (_ahead, square) => Math.sqrt(square) / Math.max(1, square),
  oriented: (ahead, square, facing) => (Math.max(0, ahead) * Math.max(0, facing)) / Math.max(1, square),
  blind: () => 0,
};

function model(world: World, agent: number): Model | null {
  const { sensor, optimal_distance: d } = world.scene.agents[agent];
  if (!Object.hasOwn(MODELS, sensor) || (sensor !== "blind" && d === null)) return null;
  return MODELS[sensor];
}

/** Whether the page can compute what an agent sees. */
export function knowsSensor(world: World, agent: number): boolean {
  return model(world, agent) !== null;
}

/** Visibility of one landmark from an agent's committed pose; NaN where the model is not known here. */
export function visibilityOf(world: World, state: State, agent: number, landmark: number): number {
  const out = new Float32Array(1);
  return fill(world, state, agent, landmark, landmark + 1, out) ? out[0] : NaN;
}

/** Visibility of every landmark from an agent's committed pose, or null where the model is not known here. */
export function heatMap(world: World, state: State, agent: number): Float32Array | null {
  const out = new Float32Array(world.n);
  return fill(world, state, agent, 0, world.n, out) ? out : null;
}

function fill(world: World, state: State, agent: number, from: number, to: number, out: Float32Array): boolean {
  const see = model(world, agent);
  if (!see) return false;
  const pose = state.poses.subarray(agent * POSE, (agent + 1) * POSE);
  const yaw = yawOf(pose);
  const [c, s, d] = [Math.cos(yaw), Math.sin(yaw), world.scene.agents[agent].optimal_distance ?? 1];
  for (let k = from; k < to; k++) {
    const dx = (world.positions[3 * k] - pose[0]) / d;
    const dy = (world.positions[3 * k + 1] - pose[1]) / d;
    const facing = world.normals ? -(c * world.normals[3 * k] + s * world.normals[3 * k + 1]) : 1;
    out[k - from] = see(c * dx + s * dy, dx * dx + dy * dy, facing);
  }
  return true;
}

/**
 * Outline of where a landmark is seen at least half as well as it can be, in optimal distances, the camera looking along x:
 * for the thesis's camera the disc of radius 1 about (1, 0) beyond x = 1/2, for an isotropic one the ring from 1/2 to 2.
 */
export function fieldOfView(world: World, agent: number): Path2D | null {
  const { sensor, optimal_distance: d } = world.scene.agents[agent];
  if (d === null) return null;
  const path = new Path2D();
  if (sensor === "anisotropic" || sensor === "oriented") {
    const half = (2 * Math.PI) / 3;
    path.arc(d, 0, d, -half, half);
    path.closePath();
    return path;
  }
  if (sensor === "isotropic") {
    path.arc(0, 0, 2 * d, 0, 2 * Math.PI);
    path.moveTo(d / 2, 0);
    path.arc(0, 0, d / 2, 0, 2 * Math.PI, true);
    return path;
  }
  return null;
}
