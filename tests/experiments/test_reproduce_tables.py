"""The tables of the paper's runs: averages, spreads, dashes, sources and doubts."""

import csv
import io
import re

import pytest

METHOD = "gsjax paper_6k_15k, refined"


@pytest.fixture
def made(scripts):
    """Tables of hand-made scores: two seeds of truck and train, one run of kitchen, nothing of Deep Blending."""
    Measured, report = scripts("paper.measured").Measured, scripts("paper.report")
    scores = {("truck", 0): (24.0, 0.86), ("truck", 1): (25.0, 0.88), ("train", 0): (20.0, 0.74),
              ("train", 1): (22.0, 0.76), ("kitchen", 0): (30.125, 0.9)}  # fmt: skip
    measured = [Measured(scene, METHOD, seed, *pair, None, 9) for (scene, seed), pair in scores.items()]
    return report.tables(measured, [METHOD], {"truck": "truck: growth was held at 5% & 3_000 Gaussians."})


def rows_of(scripts, made):
    text = scripts("paper.report").comma_separated(made)
    return {(row["over"], row["method"]): row for row in csv.DictReader(io.StringIO(text))}


def test_averages_are_over_seeds_then_scenes_and_the_spread_over_seeds(scripts, made):
    row = rows_of(scripts, made)["Tanks & Temples", METHOD]
    assert float(row["psnr"]) == pytest.approx((24.5 + 21) / 2)
    assert float(row["psnr_spread"]) == pytest.approx(1.5 / 2**0.5, abs=1e-4)  # seeds: 22.0 and 23.5
    assert (row["lpips"], row["lpips_spread"], row["scenes"], row["seeds"]) == ("-", "-", "2", "2")


def test_fewer_scenes_than_published_are_named_and_absent_ones_are_dashes(scripts, made):
    rows = rows_of(scripts, made)
    indoor, outdoor = rows["Mip-NeRF 360, indoor", METHOD], rows["Mip-NeRF 360, outdoor", METHOD]
    assert (indoor["scenes"], indoor["psnr_spread"], indoor["seeds"]) == ("1 of 4 (kitchen)", "-", "1")
    assert (outdoor["scenes"], outdoor["psnr"], outdoor["source"]) == ("0 of 3", "-", "-")
    assert rows["playroom", METHOD]["ssim"] == "-"
    assert "0.000" not in scripts("paper.report").markdown(made), "never a zero where there is nothing"


def test_an_average_with_a_figure_missing_in_one_scene_is_a_dash(scripts):
    module = scripts("paper.measured")
    rows = [
        module.Measured(scene, METHOD, 0, 20.0, 0.8, lpips, 9, squeeze=0.25)
        for scene, lpips in [("truck", 0.2), ("train", None)]
    ]
    found = module.average(rows, METHOD, ["truck", "train"])
    assert found.values["lpips"] is None and found.values["psnr"].mean == 20
    assert found.values["squeeze"].mean == 0.25


def test_a_seed_that_one_scene_lacks_counts_for_the_mean_and_not_for_the_spread(scripts):
    module = scripts("paper.measured")
    numbers = [("truck", 0, 20.0), ("truck", 1, 22.0), ("train", 0, 24.0)]
    rows = [module.Measured(scene, METHOD, seed, psnr, 0.8, None, 9) for scene, seed, psnr in numbers]
    found = module.average(rows, METHOD, ["truck", "train"])
    assert found.values["psnr"] == module.Value(22.5, None) and found.seeds == (1, 2)


def test_published_rows_carry_source_and_doubts(scripts, made):
    rows = rows_of(scripts, made)
    row = rows["Mip-NeRF 360, indoor", "The paper"]
    assert float(row["lpips"]) == 0.117 and "0.117 is doubtful" in row["notes"]
    assert rows["Deep Blending", "SuGaR"]["source"] == "tab:deepblend of the paper, which quotes SuGaR's"
    assert rows["Tanks & Temples", "SuGaR"]["notes"] == ""
    text = scripts("paper.report").markdown(made)
    assert "| The paper [1,2]" not in text, "notes are numbered in the order of the table"
    mark = re.search(r"\| The paper \[(\d+),(\d+)\] \| 29.87 \| 0.921 \| 0.117 \| - \| 4 \|", text)
    assert mark and f"[{mark[1]}] The LPIPS of 0.117 is doubtful" in text


def test_latex_escapes_and_says_plus_minus(scripts, made):
    text = scripts("paper.report").latex(made)
    assert r"\caption{Tanks \& Temples}" in text
    assert r"gsjax paper\_6k\_15k, refined$^{" in text
    assert r"truck: growth was held at 5\% \& 3\_000 Gaussians." in text
    assert r"22.75 $\pm$ 1.06" in text
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 3
    for line in text.splitlines():
        if " & " in line and line.endswith((r"\\", r"\hline")):
            assert len(re.findall(r"(?<!\\)&", line)) == 7, line


def test_a_cap_that_bound_and_own_normals_are_told(scripts):
    bound = {"train": {"cap_bound": True, "max_gaussians": 2000, "normals": "maps"}}
    own = {"train": {"cap_bound": False, "normals": None}}
    said = scripts("reproduce").remarks(
        [("room", "paper_6k_15k", 1, bound), ("truck", "paper_6k_15k", 0, own), ("train", "vanilla", 0, own)]
    )
    assert said["room"] == "room: paper_6k_15k, seed 1: growth was held at 2,000 Gaussians."
    assert "own smoothed normals" in said["truck"] and "train" not in said
