"""What the paper's tables print, quoted, and what is doubtful about it."""

from typing import NamedTuple

from paper.scenes import BLENDING, INDOOR, OUTDOOR, TANKS

PAPER, PAPER_7K = "The paper", "The paper (7K refinement)"

PUBLISHED: dict[str, dict[str, tuple[float, float, float]]] = {
    INDOOR: {
        "Plenoxels": (24.83, 0.766, 0.426),
        "INGP-Base": (28.65, 0.840, 0.281),
        "INGP-Big": (29.14, 0.863, 0.242),
        "Mip-NeRF 360": (31.58, 0.914, 0.182),
        "BakedSDF": (27.06, 0.836, 0.258),
        "3DGS": (30.41, 0.920, 0.189),
        "SuGaR": (29.43, 0.910, 0.216),
        PAPER: (29.87, 0.921, 0.117),
    },
    OUTDOOR: {
        "Plenoxels": (22.02, 0.542, 0.465),
        "INGP-Base": (23.47, 0.571, 0.416),
        "INGP-Big": (23.57, 0.602, 0.375),
        "Mip-NeRF 360": (25.79, 0.746, 0.247),
        "MobileNeRF": (21.95, 0.470, 0.470),
        "3DGS": (26.40, 0.805, 0.173),
        "SuGaR": (24.40, 0.699, 0.301),
        PAPER: (24.61, 0.719, 0.262),
    },
    TANKS: {
        "Plenoxels": (21.07, 0.719, 0.379),
        "INGP-Base": (21.72, 0.723, 0.330),
        "INGP-Big": (21.92, 0.744, 0.304),
        "Mip-NeRF 360": (22.22, 0.758, 0.257),
        "3DGS": (23.14, 0.841, 0.183),
        "SuGaR": (21.58, 0.795, 0.219),
        PAPER: (21.83, 0.802, 0.216),
    },
    BLENDING: {
        "Plenoxels": (23.06, 0.794, 0.510),
        "INGP-Base": (23.62, 0.796, 0.423),
        "INGP-Big": (24.96, 0.817, 0.390),
        "Mip-NeRF 360": (29.40, 0.901, 0.244),
        "3DGS": (29.41, 0.903, 0.242),
        "SuGaR": (29.41, 0.893, 0.267),
        PAPER: (29.55, 0.893, 0.269),
        PAPER_7K: (29.72, 0.894, 0.277),
    },
}
"""PSNR in dB, SSIM, LPIPS of VGG: means over a part's scenes."""

LABELS = {INDOOR: "tab:mipnerf", OUTDOOR: "tab:mipnerf", TANKS: "tab:tanks", BLENDING: "tab:deepblend"}
"""The paper's own names of its tables."""


def source(part: str, method: str) -> str:
    """Where a published row is quoted from."""
    own = method in (PAPER, PAPER_7K)
    return f"{LABELS[part]} of the paper" + ("" if own else ", which quotes SuGaR's")


class Note(NamedTuple):
    """A doubt about one row of one part, or where `part` is None about the rows of a method in all of them."""

    method: str
    part: str | None
    text: str


NOTES = (
    Note(PAPER, INDOOR, "The LPIPS of 0.117 is doubtful: all other methods are between 0.182 and 0.426, and the row's"
         " PSNR and SSIM are near SuGaR's. A misprint, or another network, is likely."),
    Note(PAPER, None, "The paper does not say which of its two budgets this row is; it is read as 6,000 steps with R"
         " and 15,000 of refinement."),
    Note(PAPER_7K, BLENDING, "As printed, this budget (7,000 + 2,000 + 13,000 + 7,000) has 29,000 steps, not the"
         " 30,000 of the text."),
    Note(PAPER, BLENDING, "The text calls these results better than all baselines'. That holds for PSNR alone: 3DGS and"
         " Mip-NeRF 360 have the better SSIM and LPIPS. It also calls the scenes synthetic; they were photographed."),
    Note("BakedSDF", INDOOR, "Listed for the indoor scenes only, though the text claims a gain outdoors too."),
    Note("MobileNeRF", OUTDOOR, "Listed for the outdoor scenes only, though the text claims a gain indoors too."),
    Note("Plenoxels", None, "The paper cites another work (PhySG) for this method."),
    Note("Mip-NeRF 360", None, "The paper cites Mip-NeRF for this method."),
)  # fmt: skip


def notes_of(part: str, method: str) -> list[str]:
    """The doubts about a published row."""
    return [note.text for note in NOTES if note.method == method and note.part in (part, None)]
