// What the shared page needs of other people's code; `fetch.sh` makes libraries.min.js.gz of it.
export {
  AmbientLight, Color, Group, Matrix4, PerspectiveCamera, Scene, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
export { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
