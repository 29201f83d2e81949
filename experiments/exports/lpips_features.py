"""How do LPIPS' features and weights become an ONNX file for `gsjax eval --lpips`?

    python experiments/exports/lpips_features.py {vgg,alex,squeeze} OUT.onnx

Needs torch and the authors' package lpips (BSD-2-Clause), which fetches torchvision's backbones. Written from the
package's source, and not run here.
"""

import argparse
from pathlib import Path


def export(net: str, out: Path) -> None:
    """Fetches a network and writes it, for pictures of any size."""
    import lpips
    import torch

    class Features(torch.nn.Module):
        """A picture `[1, 3, H, W]` in -1..1 to the features of the layers, then the layers' weights."""

        def __init__(self):
            super().__init__()
            self.model = lpips.LPIPS(net=net).eval()

        def forward(self, picture: torch.Tensor) -> tuple[torch.Tensor, ...]:
            """Two a layer."""
            features = self.model.net(self.model.scaling_layer(picture))
            return (*features, *[layer.model[-1].weight for layer in self.model.lins])

    torch.onnx.export(
        Features(),
        (torch.zeros(1, 3, 64, 64),),
        str(out),
        input_names=["picture"],
        dynamic_axes={"picture": {2: "height", 3: "width"}},
        opset_version=17,
        dynamo=False,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("net", choices=("vgg", "alex", "squeeze"))
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    export(arguments.net, arguments.out)
