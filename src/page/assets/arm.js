// The arm, what stands round it and what lies on the table, in three dimensions. Without WebGL there is the
// table from above alone.

import { h, card } from "./dom.js";
import { on, state } from "./net.js";
import { carried } from "./table.js";
import { t } from "./text.js";

const kindColour = { arm: 0x8fa3b8, tool: 0x3f4a56, stand: 0x6b6257, equipment: 0x9a8f7c };

export function arm3d() {
  const canvas = h("canvas", { width: 800, height: 600, tabindex: 0, role: "img", "aria-label": t("The arm in three dimensions; drag or arrow keys turn the view, wheel or + and - zoom") });
  const words = h("p", { class: "soft" });
  const element = card(t("The arm"), canvas, words);
  const view = { element, stop: () => {} };
  const joints = () => {
    const arm = state.arm;
    words.textContent = arm ? `${t("Joints")}: ${arm.q.map((q) => Math.round(q * 180 / Math.PI) + "°").join("  ")}` : t("The robot has not answered yet.");
  };
  joints();
  const stops = [on("arm", joints)];
  let gone = false;
  view.stop = () => { gone = true; stops.forEach((stop) => stop()); };
  // Large, and the only thing here that is: after everything that can be read.
  const idle = new Promise((done) => (window.requestIdleCallback ? requestIdleCallback(done, { timeout: 1500 }) : setTimeout(done, 300)));
  idle.then(() => gone ? null : import("./vendor/three.module.min.js")).then((three) => {
    if (gone) return;
    try {
      stops.push(...scene(three, canvas));
    } catch {
      canvas.remove();
    }
  }, () => canvas.remove());
  return view;
}

/** Everything within a radius of the points: a capsule, or a box round the points of a hull. */
function shape(three, { points, radius, kind }) {
  const material = new three.MeshStandardMaterial({ color: kindColour[kind], roughness: 0.65, metalness: 0.15, transparent: kind === "equipment", opacity: kind === "equipment" ? 0.45 : 1 });
  if (points.length === 2) {
    const [a, b] = points.map((point) => new three.Vector3(...point));
    const mesh = new three.Mesh(new three.CapsuleGeometry(radius, a.distanceTo(b), 6, 20), material);
    mesh.position.copy(a).add(b).multiplyScalar(0.5);
    const along = b.clone().sub(a);
    if (along.length() > 1e-9) mesh.quaternion.setFromUnitVectors(new three.Vector3(0, 1, 0), along.normalize());
    return mesh;
  }
  const box = new three.Box3().setFromPoints(points.map((point) => new three.Vector3(...point)));
  const size = box.getSize(new three.Vector3()).addScalar(2 * radius);
  const mesh = new three.Mesh(new three.BoxGeometry(size.x, size.y, size.z), material);
  box.getCenter(mesh.position);
  return mesh;
}

function scene(three, canvas) {
  const renderer = new three.WebGLRenderer({ canvas, antialias: true, alpha: true });
  const world = new three.Scene();
  world.add(new three.HemisphereLight(0xffffff, 0x556070, 2.4));
  const sun = new three.DirectionalLight(0xffffff, 1.6);
  sun.position.set(1, -1.5, 3);
  world.add(sun);
  const camera = new three.PerspectiveCamera(40, 4 / 3, 0.05, 20);
  camera.up.set(0, 0, 1);
  const [width, depth] = state.cell.table;
  const table = new three.Group();
  const pose = (group, [x, y, z, a, b, c, d]) => { group.position.set(x, y, z); group.quaternion.set(a, b, c, d); };
  pose(table, state.cell.base_from_table);
  const top = new three.Mesh(new three.BoxGeometry(width + 0.16, depth + 0.16, 0.02), new three.MeshStandardMaterial({ color: 0xd8d2c4 }));
  top.position.set(width / 2, depth / 2, -0.0105);
  table.add(top);
  const lying = new three.Group();
  table.add(lying);
  world.add(table);
  const frames = Array.from({ length: 8 }, () => new three.Group());
  frames.forEach((frame) => world.add(frame));
  for (const body of state.cell.bodies) frames[body.frame]?.add(shape(three, body));

  const held = () => state.status?.holding ? state.cell.objects.find((known) => state.status.holding.includes(known.id))?.id : null;
  const prism = (known) => {
    const flat = new three.Shape(known.outline.map(([x, y]) => new three.Vector2(x, y)));
    const style = new three.MeshStandardMaterial({ color: new three.Color(known.colour.replaceAll(" ", ",").replace("hsl(", "hsl(")), roughness: 0.8 });
    return new three.Mesh(new three.ExtrudeGeometry(flat, { depth: known.height || 0.005, bevelEnabled: false }), style);
  };
  const place = (mesh, { pose: [x, y, theta], bottom_m: bottom = 0 }) => {
    mesh.position.set(x, y, bottom);
    mesh.rotation.z = theta;
  };
  let hanging = null;
  const lay = () => {
    lying.clear();
    hanging = null;
    const moved = new Map(carried().map((object) => [object.id, object]));
    const unknown = held();
    for (const id of new Set([...(state.sight?.objects ?? []).map((object) => object.id), ...moved.keys()])) {
      const known = state.cell.objects.find((other) => other.id === id);
      const at = moved.get(id) ?? (id === unknown ? null : state.sight.objects.find((object) => object.id === id));
      if (!known || !at) continue;
      const mesh = prism(known);
      place(mesh, at);
      if (at.held) hanging = { id, mesh };
      lying.add(mesh);
    }
    draw();
  };
  const middle = new three.Vector3(width / 2, depth / 2, 0.15).applyQuaternion(table.quaternion).add(table.position).multiplyScalar(0.6);
  const look = { turn: -0.9, tilt: 0.45, far: 2.1 };
  let wanted = false;
  const paint = () => {
    wanted = false;
    const { clientWidth, clientHeight } = canvas;
    if (!clientWidth) return;
    const size = renderer.getSize(new three.Vector2());
    if (size.x !== clientWidth || size.y !== clientHeight) {
      renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      renderer.setSize(clientWidth, clientHeight, false);
      camera.aspect = clientWidth / clientHeight;
      camera.updateProjectionMatrix();
    }
    const flat = Math.cos(look.tilt) * look.far;
    camera.position.set(middle.x + flat * Math.cos(look.turn), middle.y + flat * Math.sin(look.turn), middle.z + Math.sin(look.tilt) * look.far);
    camera.lookAt(middle);
    renderer.render(world, camera);
  };
  const draw = () => { if (!wanted) { wanted = true; requestAnimationFrame(paint); } };
  const move = () => {
    (state.arm?.frames ?? []).forEach((frame, index) => frames[index] && pose(frames[index], frame));
    const taken = state.arm?.carried;
    if (taken?.id !== hanging?.id) return lay();
    if (taken) place(hanging.mesh, taken);
    draw();
  };
  const turned = (dx, dy) => { look.turn -= dx; look.tilt = Math.min(1.5, Math.max(-0.1, look.tilt + dy)); draw(); };
  const zoomed = (factor) => { look.far = Math.min(6, Math.max(0.6, look.far * factor)); draw(); };
  canvas.addEventListener("pointermove", (event) => { if (event.buttons) turned(event.movementX * 0.008, event.movementY * 0.008); });
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoomed(event.deltaY > 0 ? 1.1 : 0.9); }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const keys = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    if (keys[event.key]) { event.preventDefault(); turned(...keys[event.key]); }
    if (event.key === "+" || event.key === "-") zoomed(event.key === "-" ? 1.1 : 0.9);
  });
  move();
  lay();
  const resized = new ResizeObserver(draw);
  resized.observe(canvas);
  return [on("arm", move), on("sight", lay), on("carried", lay), on("status", lay), () => { resized.disconnect(); renderer.dispose(); renderer.forceContextLoss(); }];
}
