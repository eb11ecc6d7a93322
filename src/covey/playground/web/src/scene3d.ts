// The 3-D view: vehicles with their attitude, paths, landmarks, obstacles. A bundle of its own, loaded when it is asked for.

import {
  AmbientLight, BoxGeometry, BufferAttribute, BufferGeometry, CanvasTexture, CircleGeometry, Color, ConeGeometry, CylinderGeometry, DirectionalLight, DoubleSide,
  ExtrudeGeometry, GridHelper, Group, IcosahedronGeometry, InstancedMesh, Line, LineBasicMaterial, LineDashedMaterial, Matrix4, Mesh, MeshBasicMaterial,
  MeshLambertMaterial, NearestFilter, PerspectiveCamera, PlaneGeometry, Points, PointsMaterial, Quaternion, RingGeometry, Scene as Stage, Shape, SphereGeometry, Sprite,
  SpriteMaterial, SRGBColorSpace, Vector2, Vector3, WebGLRenderer, type Object3D,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

import { Cells } from "./cells";
import { inkOn, readInks } from "./colour";
import { extent } from "./map";
import { Activity, POSE } from "./messages";
import type { Session } from "./session";
import { shownPose, type Obstacle, type State, type World } from "./state";
import type { Path } from "./timeline";

const MOST_BODIES = 5000;
const TALLEST = 1e3;

/** Whether this browser can draw in 3-D. */
export function available(): boolean {
  return document.createElement("canvas").getContext("webgl2") !== null;
}

export class View3d {
  private readonly renderer: WebGLRenderer;
  private readonly camera = new PerspectiveCamera(45, 1, 0.01, 5000);
  private readonly orbit: OrbitControls;
  private stage = new Stage();
  private scenes = -1;
  private cells: Cells | null = null;
  private ground: CanvasTexture<OffscreenCanvas> | null = null;
  private bodies: InstancedMesh | Points | null = null;
  /** Which of the bodies each landmark is that has one. */
  private bodyOf = new Map<number, number>();
  private vehicles: { group: Group; stem: Line; label: Sprite; waypoint: Mesh; trail: Line; path: Path | null; points: number }[] = [];
  private obstacles: Object3D[] = [];
  private balls: Mesh[] = [];
  private shownObstacles: Obstacle[] | null = null;
  private stale = true;
  private mission = "";
  private size = 1;
  private home = { middle: new Vector3(), radius: 1 };

  constructor(private readonly frame: HTMLElement) {
    this.renderer = new WebGLRenderer({ antialias: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    frame.append(this.renderer.domElement);
    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, this.renderer.domElement);
    this.orbit.addEventListener("change", () => (this.stale = true));
    this.orbit.maxPolarAngle = Math.PI / 2 + 0.3;
  }

  setTheme(): void {
    this.scenes = -1;
  }

  resize(): void {
    const [w, h] = [this.frame.clientWidth, this.frame.clientHeight];
    if (w < 2 || h < 2) return;
    const now = this.renderer.getSize(new Vector2());
    if (now.x === w && now.y === h) return;
    this.renderer.setSize(w, h);
    this.camera.aspect = w / h;
    this.camera.updateProjectionMatrix();
    this.stale = true;
  }

  /** Look at everything. */
  goHome(): void {
    const { middle, radius } = this.home;
    this.camera.far = 100 * radius;
    this.camera.near = 0.005 * radius;
    const half = (this.camera.fov * Math.PI) / 360;
    const away = (0.92 * radius) / Math.sin(Math.min(half, Math.atan(Math.tan(half) * this.camera.aspect)));
    this.camera.position.copy(middle).add(new Vector3(-0.28, -0.76, 0.58).normalize().multiplyScalar(away));
    this.camera.updateProjectionMatrix();
    this.orbit.target.copy(middle);
    this.orbit.update();
    this.stale = true;
  }

  draw(session: Session, moved: boolean): void {
    const { world, state } = session;
    if (!world || !state) return;
    this.resize();
    if (this.scenes !== session.scenes) this.build(world, state, session.scenes);
    const { dirty } = session;
    if (dirty.all || dirty.cells.length) this.colour(state, dirty.all ? null : dirty.cells);
    dirty.clear();
    if (state.obstacles !== this.shownObstacles) this.buildObstacles(state);
    if (moved || this.stale) {
      this.place(session, state);
      this.renderer.render(this.stage, this.camera);
      this.stale = false;
    }
  }

  private build(world: World, state: State, scenes: number): void {
    this.scenes = scenes;
    const inks = readInks();
    this.stage = new Stage();
    this.stage.background = new Color(inks.paper);
    this.stage.add(new AmbientLight(0xffffff, 1.7));
    const sun = new DirectionalLight(0xffffff, 1.8);
    sun.position.set(-3, -5, 9);
    this.stage.add(sun);
    const bounds = extent(world, state);
    const [w, h] = [bounds.xMax - bounds.xMin, bounds.yMax - bounds.yMin];
    this.size = Math.max(w, h);
    let top = 0;
    for (let agent = 0; agent < world.m; agent++) top = Math.max(top, state.poses[POSE * agent + 2] || 0);
    const middle = new Vector3((bounds.xMin + bounds.xMax) / 2, (bounds.yMin + bounds.yMax) / 2, top / 2);
    this.home = { middle, radius: 0.5 * Math.hypot(w, h, top) };
    const lines = new GridHelper(2 * Math.ceil(this.size), Math.min(2 * Math.ceil(this.size), 60), inks.faint, inks.line);
    lines.rotation.x = Math.PI / 2;
    lines.position.set(Math.round(middle.x), Math.round(middle.y), -0.012 * this.size);
    for (const material of [lines.material].flat()) Object.assign(material, { transparent: true, opacity: 0.35 });
    this.stage.add(lines);
    this.cells = new Cells(world, inks);
    this.addLandmarks(world);
    this.addRegion(world, inks.ink);
    this.vehicles = world.colours.map((colour, agent) => this.addVehicle(colour, agent, inks.ink));
    this.balls = [];
    this.shownObstacles = null;
    this.colour(state, null);
    if (this.mission !== world.scene.mission) {
      this.mission = world.scene.mission;
      this.goHome();
    }
    this.stale = true;
  }

  private addLandmarks(world: World): void {
    const lattice = this.cells?.lattice;
    this.ground = this.bodies = null;
    if (lattice && this.cells?.texture) {
      this.ground = new CanvasTexture(this.cells.texture);
      this.ground.magFilter = NearestFilter;
      this.ground.colorSpace = SRGBColorSpace;
      const [w, h] = [lattice.columns * lattice.size, lattice.rows * lattice.size];
      const plane = new Mesh(new PlaneGeometry(w, h), new MeshBasicMaterial({ map: this.ground, transparent: true, side: DoubleSide }));
      plane.position.set(lattice.xMin + w / 2, lattice.yMax - h / 2, 0);
      this.stage.add(plane);
    }
    this.bodyOf = new Map(Array.from(lattice?.loose ?? Array(world.n).keys(), (k, body) => [k, body]));
    const count = this.bodyOf.size;
    if (count === 0) return;
    if (count > MOST_BODIES) {
      const places = Float32Array.from([...this.bodyOf.keys()].flatMap((k) => [...world.positions.subarray(3 * k, 3 * k + 3)]));
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(places, 3));
      geometry.setAttribute("color", new BufferAttribute(new Float32Array(3 * count), 3));
      this.bodies = new Points(geometry, new PointsMaterial({ size: 3, sizeAttenuation: false, vertexColors: true }));
      this.stage.add(this.bodies);
      return;
    }
    const radius = lattice ? Math.max(0.3 * lattice.size, 0.003 * this.size) : world.cellSize > 0 ? 0.45 * world.cellSize : 0.011 * this.size;
    const shape = world.normals ? new CircleGeometry(radius, 16) : new IcosahedronGeometry(radius, 1);
    this.bodies = new InstancedMesh(shape, new MeshLambertMaterial({ side: DoubleSide }), count);
    // On cells of their own colour they would hardly be seen.
    const rims = lattice && new InstancedMesh(new CircleGeometry(1.3 * radius, 24), new MeshBasicMaterial({ color: 0x1a1a1a, side: DoubleSide }), count);
    const [matrix, turn, up] = [new Matrix4(), new Quaternion(), new Vector3(0, 0, 1)];
    for (const [k, body] of this.bodyOf) {
      if (world.normals) turn.setFromUnitVectors(up, new Vector3(...world.normals.subarray(3 * k, 3 * k + 3)));
      const place = new Vector3(...world.positions.subarray(3 * k, 3 * k + 3));
      rims?.setMatrixAt(body, matrix.makeTranslation(place.x, place.y, place.z + 0.001 * this.size));
      if (lattice) place.z += 0.8 * radius;
      matrix.compose(place, turn, new Vector3(1, 1, 1));
      this.bodies.setMatrixAt(body, matrix);
      this.bodies.setColorAt(body, new Color(0xffffff));
    }
    this.stage.add(this.bodies);
    if (rims) this.stage.add(rims);
  }

  private addRegion(world: World, ink: string): void {
    for (const ring of world.region) {
      const points: Vector3[] = [];
      for (let i = 0; i <= ring.length; i += 2) points.push(new Vector3(ring[i % ring.length], ring[(i + 1) % ring.length], 0.001 * this.size));
      this.stage.add(new Line(new BufferGeometry().setFromPoints(points), new LineBasicMaterial({ color: ink })));
    }
  }

  private addVehicle(colour: string, agent: number, ink: string): (typeof this.vehicles)[number] {
    const arm = 0.022 * this.size;
    const group = new Group();
    const paint = new MeshLambertMaterial({ color: colour });
    const dark = new MeshLambertMaterial({ color: 0x1a1a1a });
    group.add(new Mesh(new BoxGeometry(0.9 * arm, 0.55 * arm, 0.3 * arm), dark));
    for (const [x, y] of [[1, 1], [1, -1], [-1, 1], [-1, -1]]) {
      const rotor = new Mesh(new CylinderGeometry(0.55 * arm, 0.55 * arm, 0.09 * arm, 20), paint);
      rotor.rotation.x = Math.PI / 2;
      rotor.position.set(0.85 * arm * x, 0.85 * arm * y, 0.2 * arm);
      group.add(rotor);
      const beam = new Mesh(new BoxGeometry(1.2 * arm, 0.14 * arm, 0.12 * arm), dark);
      beam.position.set(0.45 * arm * x, 0.45 * arm * y, 0.1 * arm);
      beam.rotation.z = Math.atan2(y, x);
      group.add(beam);
    }
    const nose = new Mesh(new ConeGeometry(0.28 * arm, 1.2 * arm, 12), new MeshLambertMaterial({ color: 0xffffff }));
    nose.rotation.z = -Math.PI / 2;
    nose.position.x = 1.3 * arm;
    group.add(nose);
    const stem = new Line(new BufferGeometry().setFromPoints([new Vector3(), new Vector3()]), new LineDashedMaterial({ color: ink, dashSize: 0.5 * arm, gapSize: 0.4 * arm }));
    const waypoint = new Mesh(new RingGeometry(0.5 * arm, 0.8 * arm, 24), new MeshBasicMaterial({ color: colour, side: DoubleSide }));
    const trail = new Line(new BufferGeometry(), new LineBasicMaterial({ color: colour }));
    trail.frustumCulled = stem.frustumCulled = false;
    const label = sprite(String(agent + 1), colour, 1.5 * arm);
    this.stage.add(group, stem, waypoint, trail, label);
    return { group, stem, label, waypoint, trail, path: null, points: 0 };
  }

  private buildObstacles(state: State): void {
    this.shownObstacles = state.obstacles;
    for (const old of this.obstacles) this.stage.remove(old);
    const material = new MeshLambertMaterial({ color: 0x8a929b, transparent: true, opacity: 0.75 });
    this.obstacles = state.obstacles.map((obstacle) => {
      const points: Vector2[] = [];
      for (let i = 0; i + 1 < obstacle.outline.length; i += 2) points.push(new Vector2(obstacle.outline[i], obstacle.outline[i + 1]));
      if (obstacle.radius > 0) {
        const ball = new Mesh(new SphereGeometry(obstacle.radius, 28, 18), material);
        const middle = points.reduce((sum, point) => sum.add(point), new Vector2()).divideScalar(points.length);
        ball.position.set(middle.x, middle.y, (obstacle.zMin + obstacle.zMax) / 2);
        return ball;
      }
      const depth = Math.min(obstacle.zMax - obstacle.zMin, TALLEST, 0.6 * this.size);
      const prism = new Mesh(new ExtrudeGeometry(new Shape(points), { depth, bevelEnabled: false }), material);
      prism.position.z = Math.max(obstacle.zMin, -TALLEST);
      return prism;
    });
    for (const made of this.obstacles) this.stage.add(made);
    this.stale = true;
  }

  private colour(state: State, changed: number[] | null): void {
    const { cells, bodies } = this;
    if (!cells) return;
    this.stale = true;
    if (this.ground) {
      cells.paint(state, changed, null);
      this.ground.needsUpdate = true;
    }
    if (!bodies) return;
    const [colour, paper] = [new Color(), new Color(readInks().paper)];
    const points = bodies instanceof Points ? (bodies.geometry.getAttribute("color") as BufferAttribute) : null;
    for (const k of changed ?? this.bodyOf.keys()) {
      const body = this.bodyOf.get(k);
      if (body === undefined) continue;
      const { colour: { r, g, b }, alpha } = cells.shade(state, k, null);
      colour.setRGB(r / 255, g / 255, b / 255, SRGBColorSpace).lerp(paper, 1 - alpha);
      if (points) points.setXYZ(body, colour.r, colour.g, colour.b);
      else if (bodies instanceof InstancedMesh) bodies.setColorAt(body, colour);
    }
    if (points) points.needsUpdate = true;
    else if (bodies instanceof InstancedMesh && bodies.instanceColor) bodies.instanceColor.needsUpdate = true;
  }

  private place(session: Session, state: State): void {
    const arm = 0.022 * this.size;
    this.vehicles.forEach((vehicle, agent) => {
      const pose = shownPose(state, agent);
      const shown = state.activity[agent] !== Activity.GONE && Number.isFinite(pose[0]);
      for (const part of [vehicle.group, vehicle.stem, vehicle.label, vehicle.waypoint]) part.visible = shown;
      if (!shown) return;
      vehicle.group.position.set(pose[0], pose[1], pose[2] + 0.3 * arm);
      vehicle.group.quaternion.set(pose[4], pose[5], pose[6], pose[3]);
      vehicle.label.position.set(pose[0], pose[1], pose[2] + 2.2 * arm);
      const way = state.poses.subarray(POSE * agent, POSE * agent + 3);
      vehicle.waypoint.position.set(way[0], way[1], 0.004 * this.size);
      const ends = vehicle.stem.geometry.getAttribute("position") as BufferAttribute;
      ends.setXYZ(0, pose[0], pose[1], pose[2]);
      ends.setXYZ(1, pose[0], pose[1], 0);
      ends.needsUpdate = true;
      vehicle.stem.computeLineDistances();
      const path = session.timeline?.paths[agent];
      if (path && (path !== vehicle.path || path.x.length !== vehicle.points)) {
        vehicle.path = path;
        vehicle.points = path.x.length;
        vehicle.trail.geometry.dispose();
        vehicle.trail.geometry = new BufferGeometry();
        vehicle.trail.geometry.setAttribute("position", new BufferAttribute(new Float32Array(path.points), 3));
      }
      if (path) vehicle.trail.geometry.setDrawRange(0, path.before(session.x));
    });
    const count = state.objects.length / 3;
    while (this.balls.length < count) {
      const ball = new Mesh(new SphereGeometry(0.6 * arm, 18, 12), new MeshLambertMaterial({ color: 0x8a929b }));
      this.balls.push(ball);
      this.stage.add(ball);
    }
    this.balls.forEach((ball, i) => {
      ball.visible = i < count;
      if (ball.visible) ball.position.set(state.objects[3 * i], state.objects[3 * i + 1], state.objects[3 * i + 2]);
    });
  }
}

function sprite(text: string, colour: string, size: number): Sprite {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 64;
  const context = canvas.getContext("2d");
  if (context) {
    context.beginPath();
    context.arc(32, 32, 29, 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill();
    context.lineWidth = 4;
    context.strokeStyle = "#1a1a1a";
    context.stroke();
    context.font = "600 34px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillStyle = inkOn(colour);
    context.fillText(text, 32, 34);
  }
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  const made = new Sprite(new SpriteMaterial({ map: texture, depthTest: false }));
  made.scale.set(size, size, 1);
  return made;
}
