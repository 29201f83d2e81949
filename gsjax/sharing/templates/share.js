"use strict";
// The page's own axes are those of SPZ, x right, y up, z back: half a turn about x from those of the scene.
const view = JSON.parse(document.getElementById("view").textContent);
const message = document.getElementById("message");
const keyframes = [];

function bytesOf(id) {
  const element = document.getElementById(id), text = atob(element.textContent.trim());
  element.remove();
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

async function loadLibraries() {
  const packed = new Blob([bytesOf("libraries")]).stream();
  const script = document.createElement("script");
  script.textContent = await new Response(packed.pipeThrough(new DecompressionStream("gzip"))).text();
  document.head.append(script);
}

// A rigid 4x4 matrix, by columns, between the scene's axes and the page's.
function turned(elements) {
  const sign = [1, -1, -1, 1];
  return elements.map((value, place) => value * sign[place % 4] * sign[Math.floor(place / 4)]);
}

async function show() {
  await loadLibraries();
  const {AmbientLight, Color, Group, GLTFLoader, Matrix4, OrbitControls, PerspectiveCamera, Scene, SparkRenderer,
    SplatMesh, Vector3, WebGLRenderer} = Libraries;
  const canvas = document.getElementById("canvas");
  const renderer = new WebGLRenderer({canvas, antialias: false});
  const scene = new Scene(), camera = new PerspectiveCamera();
  scene.background = new Color(view.background);
  // The filter that the Gaussians were trained with: 0.3 square pixels, with their light kept (mip) or not.
  scene.add(new SparkRenderer({renderer, preBlurAmount: view.is_mip ? 0 : 0.3, blurAmount: view.is_mip ? 0.3 : 0}));
  const splats = new SplatMesh({fileBytes: bytesOf("splats"), fileType: "spz"});
  await splats.initialized;
  scene.add(splats);

  const mesh = new Group();
  if (view.has_mesh) {
    const {scene: loaded} = await new GLTFLoader().parseAsync(bytesOf("mesh").buffer, "");
    const {scale, center} = view.similarity;
    mesh.add(loaded);
    mesh.rotation.x = Math.PI;
    loaded.scale.setScalar(scale);
    loaded.position.set(...center.map(value => -scale * value));
    mesh.visible = false;
    scene.add(mesh, new AmbientLight(0xffffff, Math.PI));
    document.getElementById("show").onchange = event => {
      mesh.visible = event.target.value !== "splats";
      splats.visible = event.target.value !== "mesh";
    };
  }

  const up = new Vector3(view.up[0], -view.up[1], -view.up[2]);
  const middle = new Vector3(view.middle[0], -view.middle[1], -view.middle[2]);
  camera.up.copy(up);
  camera.near = 1e-3 * view.scale;
  camera.far = 1e3 * view.scale;
  const controls = new OrbitControls(camera, canvas);
  controls.enableDamping = true;
  let slopes = [1, 1], flight = null, at = 0;

  function poseOf(bookmark) {
    const pose = new Matrix4().fromArray(turned(bookmark.viewmat)).invert();
    const position = new Vector3().setFromMatrixPosition(pose);
    const forward = new Vector3(0, 0, -1).transformDirection(pose);
    const ahead = middle.clone().sub(position).dot(forward);
    return {position, target: position.clone().addScaledVector(forward, ahead > 0 ? ahead : view.scale)};
  }

  function fit() {  // All that the photo shows is in the window.
    const aspect = window.innerWidth / window.innerHeight;
    camera.aspect = aspect;
    camera.fov = 2 * Math.atan(Math.max(slopes[1], slopes[0] / aspect)) * 180 / Math.PI;
    camera.updateProjectionMatrix();
    renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    renderer.setSize(window.innerWidth, window.innerHeight, false);
  }

  function lookFrom(index, seconds = 0.8) {
    at = (index + view.bookmarks.length) % view.bookmarks.length;
    document.getElementById("bookmarks").value = at;
    slopes = view.bookmarks[at].slopes;
    fit();
    const to = poseOf(view.bookmarks[at]);
    flight = {from: {position: camera.position.clone(), target: controls.target.clone()}, to, began: performance.now(),
      seconds};
  }

  function fly(now) {
    if (!flight) return;
    const share = flight.seconds ? Math.min(1, (now - flight.began) / 1000 / flight.seconds) : 1;
    const eased = share * share * (3 - 2 * share);
    camera.position.lerpVectors(flight.from.position, flight.to.position, Math.max(0, eased));
    controls.target.lerpVectors(flight.from.target, flight.to.target, Math.max(0, eased));
    if (share === 1) flight = null;
  }

  function keepKeyframe() {
    camera.updateMatrixWorld();
    const local = turned(camera.matrixWorldInverse.toArray()), {scale, center} = view.similarity;
    const row = i => [local[i], local[i + 4], local[i + 8]];
    const rows = [0, 1, 2].map(i =>  // World to camera: the camera stays where it is, in other units.
      [...row(i), local[i + 12] / scale - row(i).reduce((sum, value, axis) => sum + value * center[axis], 0)]);
    keyframes.push({viewmat: [...rows, [0, 0, 0, 1]], fov: camera.fov});
    const save = document.getElementById("save");
    save.disabled = keyframes.length < 2;
    save.textContent = `save path (${keyframes.length})`;
  }

  function savePath() {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([JSON.stringify({closed: false, keyframes}, null, 1)]));
    link.download = "path.json";
    link.click();
  }

  document.getElementById("bookmarks").onchange = event => lookFrom(Number(event.target.value));
  document.getElementById("previous").onclick = () => lookFrom(at - 1);
  document.getElementById("next").onclick = () => lookFrom(at + 1);
  document.getElementById("keyframe").onclick = keepKeyframe;
  document.getElementById("save").onclick = savePath;
  window.addEventListener("keydown", event => {
    if (event.target instanceof HTMLSelectElement) return;
    const does = {ArrowLeft: () => lookFrom(at - 1), ArrowRight: () => lookFrom(at + 1), k: keepKeyframe}[event.key];
    if (does) does();
  });
  canvas.addEventListener("pointerdown", () => { flight = null; });
  window.addEventListener("resize", fit);
  lookFrom(0, 0);
  renderer.setAnimationLoop(now => {
    fly(now);
    controls.update();
    renderer.render(scene, camera);
  });
  message.remove();
}

show().catch(error => { message.textContent = `This page cannot be shown here: ${error.message ?? error}`; });
