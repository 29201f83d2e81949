"""What do other people's viewers show of a file of Gaussians? Opens it in a real browser without a display.

    npm install three @sparkjsdev/spark playcanvas --prefix DIR
    python experiments/viewer_check.py spark FILE --modules DIR/node_modules --run RUN --view 0 --out picture.png

Needs Chromium. The camera is that of a view of RUN, so the picture belongs beside the one that `gsjax render` draws.
"""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from browser_check import open_page

if TYPE_CHECKING:  # It imports jax.
    from gsjax.cameras import Camera

HALF_TURN = np.diag([1.0, -1.0, -1.0, 1.0])  # About x: between x right, y down, z forward and x right, y up, z back.

SPARK = """
const THREE = await import("three");
const {SparkRenderer, SplatMesh} = await import("@sparkjsdev/spark");
const renderer = new THREE.WebGLRenderer({canvas, preserveDrawingBuffer: true});
renderer.setSize(view.width, view.height, false);
const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera();
scene.add(new SparkRenderer({renderer}));
const splats = new SplatMesh({url: "/" + view.file});
await splats.initialized;
scene.add(splats);
new THREE.Matrix4().set(...view.camera).decompose(camera.position, camera.quaternion, camera.scale);
const [left, right, top, bottom] = view.frustum;
camera.projectionMatrix.makePerspective(left, right, top, bottom, 0.01, 1000);
camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
for (let frame = 0; frame < 12; frame++) {  // The order of the splats comes from a worker.
  renderer.render(scene, camera);
  await new Promise(done => setTimeout(done, 500));
}
"""

PLAYCANVAS = """
const pc = await import("playcanvas");
const app = new pc.Application(canvas, {graphicsDeviceOptions: {preserveDrawingBuffer: true, antialias: false}});
app.setCanvasFillMode(pc.FILLMODE_NONE, view.width, view.height);
app.setCanvasResolution(pc.RESOLUTION_FIXED, view.width, view.height);
app.start();
const asset = new pc.Asset("splats", "gsplat", {url: "/" + view.file, filename: view.file});
app.assets.add(asset);
await new Promise((done, failed) => { asset.ready(done); asset.on("error", failed); app.assets.load(asset); });
const splats = new pc.Entity();
splats.addComponent("gsplat", {asset});
app.root.addChild(splats);
const camera = new pc.Entity(), pose = new pc.Mat4(), [left, right, top, bottom] = view.frustum;
pose.set(view.camera).transpose();
camera.addComponent("camera", {clearColor: new pc.Color(0, 0, 0), nearClip: 0.01, farClip: 1000});
camera.camera.calculateProjection = matrix => matrix.setFrustum(left, right, bottom, top, 0.01, 1000);
camera.setPosition(pose.getTranslation());
camera.setRotation(new pc.Quat().setFromMat4(pose));
app.root.addChild(camera);
await new Promise(done => setTimeout(done, 6000));
"""

PAGE = """<!doctype html><script type="importmap">
{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/",
 "@sparkjsdev/spark": "/@sparkjsdev/spark/dist/spark.module.js",
 "playcanvas": "/playcanvas/build/playcanvas.mjs"}}</script>
<canvas id="canvas" width="WIDTH" height="HEIGHT"></canvas>
<script type="module">
const send = (name, body) => fetch("/" + name, {method: "PUT", body});
window.onerror = message => send("error", message);
window.onunhandledrejection = event => send("error", String(event.reason));
const view = VIEW, canvas = document.getElementById("canvas");
try {
  SHOW
  await send("picture.png", await new Promise(done => canvas.toBlob(done)));
} catch (error) { send("error", String(error)); }
</script>"""
VIEWERS = {"spark": SPARK, "playcanvas": PLAYCANVAS}


def picture(viewer: str, file: Path, modules: Path, camera: "Camera") -> bytes:
    """PNG bytes of what a viewer shows of a file from a camera. The world is that of the file: turned in an SPZ."""
    width, height = camera.width, camera.height
    (fx, _, cx), (_, fy, cy), _ = np.asarray(camera.K, np.float64)
    pose = np.linalg.inv(np.asarray(camera.viewmat, np.float64)) @ HALF_TURN
    view = {
        "file": file.name,
        "width": width,
        "height": height,
        "camera": (HALF_TURN @ pose if file.suffix == ".spz" else pose).ravel().tolist(),
        "frustum": [0.01 * side for side in (-cx / fx, (width - cx) / fx, cy / fy, (cy - height) / fy)],
    }
    page = PAGE.replace("SHOW", VIEWERS[viewer]).replace("VIEW", json.dumps(view))
    page = page.replace("WIDTH", str(width)).replace("HEIGHT", str(height))
    return open_page(page, lambda path: file if path[1:] == file.name else modules / path[1:], 1)[0]


def main() -> None:
    """Reads the arguments, writes the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("viewer", choices=VIEWERS)
    parser.add_argument("file", type=Path)
    parser.add_argument("--modules", type=Path, required=True, help="folder of the packages")
    parser.add_argument("--run", required=True, help="folder whose view to take")
    parser.add_argument("--view", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    from gsjax.runs.result import open_result  # Here, and not above: it imports jax.

    camera = open_result(given.run).cameras[given.view]
    given.out.write_bytes(picture(given.viewer, given.file.resolve(), given.modules.resolve(), camera))


if __name__ == "__main__":
    main()
