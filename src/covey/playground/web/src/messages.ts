// Written by `make web` from covey/playground/messages.py and covey/runtime/watching/feed.py; do not edit.

/** An array as it comes: little-endian values in base64. */
export interface Encoded<D extends "f8" | "f4" | "i4" | "u1"> {
  dtype: D;
  shape: number[];
  data: string;
}

export const POSE = 7;
export const NOBODY = -1;

export type Run = "plan" | "flight" | "network";

export type ChangeKind = "initial" | "optimization" | "trade" | "proof" | "abandoned" | "adoption" | "death" | "return" | "joined" | "left" | "landmarks";

export const Activity = { IDLE: 0, ASKING: 1, OFFERING: 2, FLYING: 3, QUIESCENT: 4, SUSPECT: 5, DEAD: 6, GONE: 7 } as const;

/** One agent, as far as it does not change. */
export interface SceneAgent {
  name: string;
  colour: string;
  region: Encoded<"f8">[];
  sensor: string;
  optimal_distance: number | null;
}

/** Something that no vehicle may touch: a prism, or a sphere. */
export interface SceneObstacle {
  outline: Encoded<"f8">;
  z_min: number;
  z_max: number;
  radius: number;
}

/** One change of the past, without what it changed; `step` as in `History`. */
export interface PastChange {
  time: number;
  step: number;
  kind: ChangeKind;
  agents: number[];
  score: number;
  text: string;
}

/** What does not change during a run, and how everything is at its start. */
export interface Scene {
  type: "Scene";
  run: Run;
  mission: string;
  seed: number;
  sigma: number;
  trade: string;
  agents: SceneAgent[];
  positions_W: Encoded<"f8">;
  weights: Encoded<"f8">;
  normals_W: Encoded<"f8"> | null;
  cell_size: number | null;
  region: Encoded<"f8">[];
  obstacles: SceneObstacle[];
  body_radius: number;
  required_separation: number;
  origin_lonlat_deg: [number, number] | null;
  source: Record<string, unknown>;
  software: Record<string, string>;
}

/** The whole committed state: the first update, and now and then, so that one can begin to read anywhere. */
export interface TeamState {
  type: "TeamState";
  time: number;
  owner: Encoded<"i4">;
  poses: Encoded<"f8">;
  scores: Encoded<"f8">;
  weights: Encoded<"f8">;
  activity: Encoded<"u1">;
  trading: Encoded<"i4">;
  trades: number;
  bound: number | null;
}

/** The committed state changed; what is not named stayed as it was. */
export interface TeamChange {
  type: "TeamChange";
  time: number;
  kind: ChangeKind;
  agents: number[];
  landmarks: Encoded<"i4">;
  owner: Encoded<"i4">;
  posed: number[];
  poses: Encoded<"f8">;
  scored: number[];
  scores: Encoded<"f8">;
  score: number;
  text: string;
}

/** A server made an offer, or the trade was committed or dropped: these landmarks are white meanwhile. */
export interface Trading {
  type: "Trading";
  time: number;
  client: number;
  server: number;
  give: Encoded<"i4">;
  want: Encoded<"i4">;
  open: boolean;
}

/** Landmarks are worth something else from now on. */
export interface Weights {
  type: "Weights";
  time: number;
  landmarks: Encoded<"i4">;
  weights: Encoded<"f8">;
}

/** Where the vehicles are. */
export interface Motion {
  type: "Motion";
  time: number;
  poses: Encoded<"f8">;
  velocities_W: Encoded<"f8">;
  rates_B: Encoded<"f8">;
  objects_W: Encoded<"f8">;
  score_flown: number | null;
  separation: number | null;
}

/** How the agents are. */
export interface Health {
  type: "Health";
  time: number;
  activity: Encoded<"u1">;
  battery: Encoded<"f8">;
  link: Encoded<"f8">;
  heard: Encoded<"f8">;
}

/** Something worth telling that changes no owner and no committed pose. */
export interface Note {
  type: "Note";
  time: number;
  kind: string;
  agents: number[];
  text: string;
}

/** There is an obstacle from now on. */
export interface ObstacleAppeared {
  type: "ObstacleAppeared";
  time: number;
  obstacle: SceneObstacle;
}

/** No deployment of this team can score more than `bound`. */
export interface BoundFound {
  type: "BoundFound";
  time: number;
  bound: number | null;
}

/** The run is over. */
export interface Ended {
  type: "Ended";
  time: number;
  status: string;
  holds: boolean | null;
  score: number;
}

/** The first message to a visitor. */
export interface Hello {
  type: "Hello";
  source: string;
  may_steer: boolean;
  commands: string[];
  speed: number;
}

/** How the run is steered now; after the scene, and whenever it changes. */
export interface Steered {
  type: "Steered";
  paused: boolean;
  speed: number;
  loss: number;
}

/** What went before; it replaces what the page has of score curves, paths and log. */
export interface History {
  type: "History";
  step: number;
  times: Encoded<"f8">;
  steps: Encoded<"i4">;
  scores: Encoded<"f8">;
  times_flown: Encoded<"f8">;
  scores_flown: Encoded<"f8">;
  path_counts: Encoded<"i4">;
  path_x: Encoded<"f8">;
  path_points: Encoded<"f4">;
  changes: PastChange[];
  partners: Encoded<"i4">;
}

/** The answer to a command that is not carried out; only its sender gets it. */
export interface Refused {
  type: "Refused";
  command: string;
  text: string;
}

/** The answer to ``/api/heatmap?agent=``: what an agent sees from its committed pose. */
export interface HeatMap {
  type: "HeatMap";
  agent: number;
  visibility: Encoded<"f4">;
}

export type Update = TeamState | TeamChange | Trading | Weights | Motion | Health | Note | ObstacleAppeared | BoundFound | Ended;

export type Message = Scene | TeamState | TeamChange | Trading | Weights | Motion | Health | Note | ObstacleAppeared | BoundFound | Ended | Hello | Steered | History | Refused | HeatMap;

/** Let nothing more happen until `Resume`. */
export interface Pause {
  command: "pause";
}

/** Go on. */
export interface Resume {
  command: "resume";
}

/** Let the next thing happen that can be seen, then pause: of a plan the next change or offer, of a flight 0.1 s. */
export interface Step {
  command: "step";
}

/** Go as fast as this. */
export interface SetSpeed {
  command: "speed";
  speed: number;
}

/** Let an agent fail: its process ends, or its motors stop. */
export interface Kill {
  command: "kill";
  agent: number;
}

/** Let a killed agent come back. */
export interface Revive {
  command: "revive";
  agent: number;
}

/** Let a landmark be worth something else. */
export interface SetWeight {
  command: "weight";
  landmark: number;
  weight: number;
}

/** Put a cylinder on the ground in the way. */
export interface AddObstacle {
  command: "obstacle";
  x: number;
  y: number;
  radius: number;
  height: number;
}

/** Lose this share of the messages, from 0 to 1. */
export interface SetLoss {
  command: "loss";
  loss: number;
}

export type Command = Pause | Resume | Step | SetSpeed | Kill | Revive | SetWeight | AddObstacle | SetLoss;
