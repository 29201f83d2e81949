"""How does the network of the paper become an ONNX file for `gsjax normals --network omnidata`?

    python experiments/exports/omnidata.py omnidata_v2.onnx

Needs torch and timm 0.4.12, and fetches the authors' weights, which are for research and not for commercial use.
Written from what their repositories say of the model, and not run here.
"""

import argparse
from pathlib import Path

SIDE = 384  # pixels that the network takes


def export(out: Path) -> None:
    """Fetches the network and writes it."""
    import torch

    model = torch.hub.load("alexsax/omnidata_models", "surface_normal_dpt_hybrid_384").eval()
    torch.onnx.export(model, (torch.zeros(1, 3, SIDE, SIDE),), str(out), opset_version=17, dynamo=False)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    export(parser.parse_args().out)
