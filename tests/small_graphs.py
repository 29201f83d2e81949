"""ONNX graphs of a few hundred bytes whose outputs have a closed form."""

from pathlib import Path

import numpy as np
from onnx import TensorProto, helper, numpy_helper

from gsjax.metrics.lpips import CHANNELS

IR, OPSET = 8, 17  # What onnx itself would write is newer than onnxruntime loads.
TYPES = {np.float16: TensorProto.FLOAT16, np.float32: TensorProto.FLOAT, np.int64: TensorProto.INT64}
ANY = ("b", 3, "h", "w")


class SmallGraph:
    """Collects nodes; every method gives the name of what it adds."""

    def __init__(self, dtype=np.float32):
        self.dtype, self.nodes, self.constants, self.inputs, self.outputs = dtype, [], [], [], []

    def input(self, name, shape=ANY, dtype=None):
        self.inputs.append(helper.make_tensor_value_info(name, TYPES[dtype or self.dtype], shape))
        return name

    def constant(self, values, dtype=None):
        name = f"constant{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(values, dtype or self.dtype), name))
        return name

    def add(self, operator, *inputs, **attributes):
        name = f"value{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], **attributes))
        return name

    def affine(self, value, gain=1.0, bias=0.0):
        """`gain * value + bias`, numbers or one a channel of NCHW."""
        gain, bias = (np.reshape(x, (1, -1, 1, 1)) for x in (gain, bias))
        return self.add("Add", self.add("Mul", value, self.constant(gain)), self.constant(bias))

    def largest(self, value, count):
        """The `count` largest values of `[1, N]`, and their places."""
        names = [f"value{len(self.nodes)}{what}" for what in ("", "_place")]
        self.nodes.append(helper.make_node("TopK", [value, self.constant([count], np.int64)], names, axis=1))
        return names

    def shaped(self, value, *sides):
        return self.add("Reshape", value, self.constant(sides, np.int64))

    def channel(self, value, index):
        """`[B, H, W]` of NCHW."""
        return self.add("Gather", value, self.constant(index, np.int64), axis=1)

    def transposed(self, value, order):
        return self.add("Transpose", value, perm=order)

    def output(self, value, name, dtype=None, shape=None):
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        self.outputs.append(helper.make_tensor_value_info(name, TYPES[dtype or self.dtype], shape))

    def save(self, file) -> Path:
        graph = helper.make_graph(self.nodes, "small", self.inputs, self.outputs, self.constants)
        model = helper.make_model(graph, ir_version=IR, opset_imports=[helper.make_opsetid("", OPSET)])
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        Path(file).write_bytes(model.SerializeToString())
        return Path(file)


NHWC, NCHW = [0, 2, 3, 1], [0, 3, 1, 2]


def color_network(file, *, shape=ANY, gain=2.0, dtype=np.float32):
    """Normals are the photo's colours, as pictures of normals have them: `gain * colour - 1`."""
    graph = SmallGraph(dtype)
    value = graph.input("image", shape)
    value = graph.transposed(value, NCHW) if shape[1] != 3 else value
    graph.output(graph.affine(value, gain, -1.0), "normal")
    return graph.save(file)


STRIDES = (1, 2, 4, 8, 16)


def small_lpips(file, sign=1.0):
    """Layers of 1x1 convolutions of the picture, coarser and coarser, with the numbers of channels of VGG.

    Returns:
        The file; a function from a picture [H, W, 3] to the layers' features; the linear weights.
    """
    rng, graph = np.random.default_rng(0), SmallGraph()
    image = graph.input("image", (1, 3, "h", "w"))
    layers, weights = [], []
    for index, (channels, stride) in enumerate(zip(CHANNELS["vgg"], STRIDES, strict=True)):
        kernel, bias = rng.normal(size=(channels, 3)), rng.normal(size=channels)
        kernel, bias = kernel.astype(np.float32), bias.astype(np.float32)
        value = graph.add("Conv", image, graph.constant(kernel[:, :, None, None]), graph.constant(bias),
                          strides=[stride, stride])  # fmt: skip
        graph.output(graph.add("Relu", value), f"layer{index}")
        layers.append((kernel, bias, stride))
        weights.append(rng.uniform(size=channels).astype(np.float32) / channels)
    for index, weight in enumerate(weights):
        graph.output(graph.constant(sign * weight[None, :, None, None]), f"linear{index}")

    def features(picture):
        return [np.maximum(np.einsum("oc,hwc->ohw", k, picture[::s, ::s]) + b[:, None, None], 0) for k, b, s in layers]

    return graph.save(file), features, weights


PROJECTION = np.random.default_rng(0).normal(size=(3, 128)).astype(np.float32)  # of a colour, red first, from 0 to 1


def brightest_pixels(file, kind, side, count=150):
    """ALIKED or DISK whose features are the `count` brightest pixels, with `colour @ PROJECTION` for descriptors."""
    graph = SmallGraph()
    colors = graph.shaped(graph.input("image", (1, 3, side, side)), 3, side * side)
    scores, places = graph.largest(graph.add("ReduceSum", colors, graph.constant([0], np.int64)), count)
    row = graph.add("Div", places, graph.constant(side, np.int64))
    column = graph.add("Sub", places, graph.add("Mul", row, graph.constant(side, np.int64)))
    xy = graph.add("Concat", *(graph.shaped(axis, count, 1) for axis in (column, row)), axis=1)
    brightest = graph.add("Gather", colors, graph.shaped(places, count), axis=1)
    described = graph.add("MatMul", graph.transposed(brightest, [1, 0]), graph.constant(PROJECTION))
    if kind == "disk":
        graph.output(graph.shaped(xy, 1, count, 2), "keypoints", np.int64, shape=(1, count, 2))
        graph.output(scores, "scores", shape=(1, count))
        graph.output(graph.shaped(described, 1, count, 128), "descriptors", shape=(1, count, 128))
    else:  # The first and last pixel's centres are at -1 and 1.
        xy = graph.add("Mul", graph.add("Cast", xy, to=TensorProto.FLOAT), graph.constant(2 / (side - 1)))
        graph.output(graph.add("Sub", xy, graph.constant(1)), "keypoints", shape=(count, 2))
        graph.output(graph.shaped(scores, count), "scores", shape=(count,))
        graph.output(described, "descriptors", shape=(count, 128))
    return graph.save(file)


def small_lightglue(file):
    """Matches every feature with the one whose descriptor is most like it."""
    graph = SmallGraph()
    for i in range(2):
        graph.input(f"kpts{i}", (1, f"n{i}", 2))
    desc = [graph.input(f"desc{i}", (1, f"n{i}", 128)) for i in range(2)]
    likeness = graph.add("MatMul", desc[0], graph.transposed(desc[1], [0, 2, 1]))
    there = graph.shaped(graph.add("ArgMax", likeness, axis=2), -1, 1)
    ones = graph.add("Add", graph.add("Mul", there, graph.constant(0, np.int64)), graph.constant(1, np.int64))
    here = graph.add("Sub", graph.add("CumSum", ones, graph.constant(0, np.int64)), graph.constant(1, np.int64))
    graph.output(graph.add("Concat", here, there, axis=1), "matches0", np.int64, shape=("k", 2))
    graph.output(graph.add("Cast", graph.shaped(ones, -1), to=TensorProto.FLOAT), "mscores0", shape=("k",))
    return graph.save(file)
