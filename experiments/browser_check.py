"""How does a GLB look in a real browser? Opens it without a display and keeps screenshots from several sides.

    npm install three --prefix DIR
    python experiments/browser_check.py mesh.glb --three DIR/node_modules/three --out pictures

Needs Chromium. A page with three.js (its GLTFLoader, nothing from a network) draws the file and hands every picture to
the server that this script is; no more than the browser's own errors stand between the file and the picture.
"""

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import Empty, Queue

PAGE = """<!doctype html><script type="importmap">
{"imports": {"three": "/three/build/three.module.js", "three/": "/three/"}}</script>
<canvas id="canvas" width="SIZE" height="SIZE"></canvas>
<script type="module">
const send = (name, body) => fetch("/" + name, {method: "PUT", body});
window.onerror = message => send("error", message);
try {
  const THREE = await import("three");
  const {GLTFLoader} = await import("three/examples/jsm/loaders/GLTFLoader.js");
  const canvas = document.getElementById("canvas");
  const renderer = new THREE.WebGLRenderer({canvas, preserveDrawingBuffer: true});
  renderer.setSize(SIZE, SIZE, false);
  const scene = (await new GLTFLoader().loadAsync("/mesh.glb")).scene;
  scene.add(new THREE.AmbientLight(0xffffff, Math.PI));
  const box = new THREE.Box3().setFromObject(scene);
  const middle = box.getCenter(new THREE.Vector3()), radius = box.getSize(new THREE.Vector3()).length() / 2;
  const camera = new THREE.PerspectiveCamera(40, 1, radius / 100, radius * 10);
  renderer.setClearColor(0xffffff);
  for (const [index, side] of SIDES.entries()) {
    camera.up.set(...UP);
    camera.position.copy(middle).addScaledVector(new THREE.Vector3(...side).normalize(), ZOOM * radius);
    camera.lookAt(middle);
    renderer.render(scene, camera);
    await send(`side_${index}.png`, await new Promise(done => canvas.toBlob(done)));
  }
} catch (error) { send("error", String(error)); }
</script>"""


class Handler(SimpleHTTPRequestHandler):
    """Serves the page and files; takes pictures and errors."""

    def __init__(self, *arguments, page: str, locate: Callable[[str], Path], received: Queue, **keywords):
        self.page, self.locate, self.received = page, locate, received
        super().__init__(*arguments, **keywords)

    def do_GET(self):
        """The page is made here; files come from where they lie."""
        if self.path != "/":
            return super().do_GET()
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(self.page.encode())

    def do_PUT(self):
        """A picture, or an error."""
        self.received.put((self.path[1:], self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

    def translate_path(self, path: str) -> str:
        """Where the page's files lie."""
        return str(self.locate(path.partition("?")[0]))

    def log_message(self, *_):
        """Says nothing."""


def screenshots(mesh: Path, three: Path, sides: list[list[float]], up: list[float], zoom: float, size: int) -> list:
    """PNG bytes from every side; exits with the browser's error where there is one."""
    page = PAGE.replace("SIDES", json.dumps(sides)).replace("UP", json.dumps(up))
    page = page.replace("ZOOM", str(zoom)).replace("SIZE", str(size))
    return open_page(
        page, lambda path: mesh if path == "/mesh.glb" else three / path.removeprefix("/three/"), len(sides)
    )


def open_page(page: str, locate: Callable[[str], Path], count: int) -> list[bytes]:
    """PNG bytes of the `count` pictures that a page sends; exits with the browser's error where there is one.

    Args:
        page: The HTML, which PUTs each picture under a name of its own, or the text of an error under "error".
        locate: Tells from a path that the page asks for which file to serve.
        count: How many pictures to wait for.
    """
    received = Queue()
    handler = partial(Handler, page=page, locate=locate, received=received)
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        sys.exit("there is no Chromium: apt-get install chromium")
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server, tempfile.TemporaryDirectory() as profile:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        options = ["--headless=new", "--no-sandbox", "--enable-unsafe-swiftshader", f"--user-data-dir={profile}"]
        address = f"http://127.0.0.1:{server.server_port}/"
        process = subprocess.Popen([browser, *options, address], stderr=subprocess.DEVNULL)
        try:
            pictures = []
            while len(pictures) < count:
                name, body = received.get(timeout=180)
                if name == "error":
                    sys.exit(f"the browser says: {body.decode()}")
                pictures.append(body)
            return pictures
        except Empty:
            sys.exit("the browser sent nothing for three minutes")
        finally:
            process.terminate()
            process.wait()
            server.shutdown()


def main() -> None:
    """Reads the arguments, writes the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--three", type=Path, required=True, help="folder of three.js")
    parser.add_argument("--out", type=Path, required=True, help="folder for side_0.png, ...")
    parser.add_argument("--side", type=float, nargs=3, action="append", help="direction to look from; several times")
    parser.add_argument("--up", type=float, nargs=3, default=[0, 0, 1])
    parser.add_argument("--zoom", type=float, default=2.5, help="distance in radii of the mesh")
    parser.add_argument("--size", type=int, default=800, help="pixels")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    sides = given.side or [[1, 0, 0.4], [-0.5, 0.9, 0.4], [-0.5, -0.9, 0.4]]
    three = given.three.resolve()
    for index, picture in enumerate(screenshots(given.mesh.resolve(), three, sides, given.up, given.zoom, given.size)):
        (given.out / f"side_{index}.png").write_bytes(picture)


if __name__ == "__main__":
    main()
