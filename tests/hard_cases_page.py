"""The errors measured on the hard cases: the page of results that they make, and their summary by family."""

import numpy as np

COMMAND = (
    "python -m pytest tests/rasterizer/test_edge_cases.py -n 0 --long --hard-cases experiments/results/hard_cases.md"
)
BACKENDS = "reference", "native", "xla", "pallas"
HEADER = f"| Case | {' | '.join(BACKENDS)} | Bounds |"
CAMERAS = "fisheye", "ortho"
HIDDEN = "hidden, each of "
ABOUT = """\
Every row is rendered and differentiated in float32 by every backend and compared with the reference in float64. The
first number of a cell is the largest error of a pixel or an alpha, relative to the largest colour. The second is the
largest relative L2 error of a gradient: means, quats, scales, opacities, colours, camera matrices, intrinsics,
backgrounds. The last column has the bounds of both that the tests assert, and the backends whose bounds differ.

A *hidden* Gaussian must change no bit of the rest, so its errors are differences from the image without it. *Fisheye*
and *ortho* are cameras of these models, the one with a lens of four coefficients. *Planes* are the depth of the same
Gaussians with the slopes of their splats. *In front* are the planes of the front layer alone, the default depth of
training. The Pallas kernels run interpreted."""
FAMILIES = {
    "ordinary Gaussians, huge colours, denormal means": ("ordinary", "nothing odd", "huge colour", "denormal mean"),
    "degenerate rotation: zero, denormal, short, long quaternions": (
        "zero quaternion", "denormal quaternion", "short quaternion", "long quaternion",
    ),
    "zero, denormal and huge scales": (
        "one flat axis", "two flat axes", "a point", "denormal scales", "huge", "as large as float32 allows",
    ),
    "needles and discs of 1 : 1e6, grazing splats": (
        "needle 1e6", "needle 1e-6", "long needle 1e6", "long needle 1e6, along x", "disc edge-on",
        "needle along the ray", "needle past the eye", "ground at a grazing angle",
    ),
    "opacity 1 and 0": ("opacity 1", HIDDEN),
    "at the near plane, behind, far, outside the image": (
        "just past the near plane", "far away", "at the image border", "mean far outside the image", HIDDEN,
    ),
    "coincident and stacked Gaussians, up to 3,000": (
        "coincident with another", "all depths coincide", "forty copies of one", "pixels that stop early",
        "3000 on one pixel, opacity 0.005", "3000 on one pixel, opacity 0.9",
    ),
    "cameras: focal lengths of 0.01 and 1e6 px, one pixel, fisheye, orthographic": (
        "focal length 0.01 px", "focal length 1e+06 px", "one pixel", *CAMERAS,
    ),
    "non-finite input: NaN or infinite fields": (HIDDEN,),
}  # fmt: skip
"""Family -> the cases that it has; all that show nothing, and all of a camera model, by one name."""


class HardCases:
    """Errors by case and backend, as the tests measure them, and the page that they make."""

    def __init__(self):
        self.rows = {}
        self.bounds = {}

    def __call__(self, case, backend, *, value, gradient, bounds):
        self.rows.setdefault(case, {})[backend] = float(value), float(gradient)
        self.bounds.setdefault(case, {}).setdefault(backend, bounds)

    def _merged(self):
        """The rows, those of Gaussians that do not show and change nothing as one of each kind, with their number."""
        kinds, merged = {}, {}
        for case, row in self.rows.items():
            kind, _, hidden = case.partition("hidden: ")
            shows = not hidden or any(any(errors) for errors in row.values())
            if not shows:
                kinds[kind] = kinds.get(kind, 0) + 1
            merged[case if shows else kind] = row, self.bounds[case]
        return {f"{case}{HIDDEN}{kinds[case]}" if case in kinds else case: row for case, row in merged.items()}

    def page(self):
        from gsjax.io.machine import machine, versions

        everything = {**machine(), **versions()}
        about = [f"{name} {everything[name]}" for name in ("cpu", "cores", "python", "jax", "jaxlib", "numpy")]
        lines = [
            "# Hard cases of the rasterizer",
            "",
            "| | |",
            "|---|---|",
            f"| Command | `{COMMAND}` |",
            f"| Commit | {everything['commit']} |",
            f"| Machine | {', '.join(about)} |",
            "| Used in | [hard cases](../../docs/hard_cases.md) |",
            "",
            ABOUT,
            "",
            HEADER,
            "|---" * (len(BACKENDS) + 2) + "|",
        ]
        for case, (errors, bounds) in self._merged().items():
            cells = [_pair(errors.get(name, ())) for name in BACKENDS]
            lines.append(f"| {case} | {' | '.join(cells)} | {_bounds(bounds)} |")
        return "\n".join([*lines, ""])


def _pair(numbers):
    return ", ".join(f"{number:.0e}" if number else "0" for number in numbers)


def _bounds(by_backend):
    """The bounds of the first backend, and of each that has others."""
    common, *_ = by_backend.values()
    others = [f"{name} {_pair(bounds)}" for name, bounds in by_backend.items() if bounds != common]
    return "; ".join([_pair(common), *others])


def read_rows(page):
    """Case -> backend -> (errors, bounds), each of value and gradient, of the text of a page that `HardCases` made."""
    rows = {}
    for line in page.partition(HEADER)[2].splitlines()[2:]:
        case, *cells, bounds = (cell.strip() for cell in line.strip("|").split("|"))
        common, *others = bounds.split("; ")
        own = {name: text for name, _, text in (other.partition(" ") for other in others)}
        rows[case] = {
            name: (_numbers(cell), _numbers(own.get(name, common)))
            for name, cell in zip(BACKENDS, cells, strict=True)
            if cell
        }
    return rows


def _numbers(text):
    return tuple(map(float, text.split(", ")))


def _kind(case):
    """What `FAMILIES` calls a case."""
    if "hidden" in case:
        return HIDDEN
    before, separator, name = case.rpartition(": ")
    return before if separator and before in CAMERAS else name


def summary(rows):
    """A line for each measured family: the largest errors of each backend, the bounds, and whether all are below."""
    unknown = {_kind(case) for case in rows} - {kind for kinds in FAMILIES.values() for kind in kinds}
    assert not unknown, f"of no family: {sorted(unknown)}"
    lines = []
    for family, kinds in FAMILIES.items():
        cells = [(name, *cell) for case, row in rows.items() if _kind(case) in kinds for name, cell in row.items()]
        worst, bounds = ({n: np.max([c[i] for c in cells if c[0] == n], axis=0) for n, *_ in cells} for i in (1, 2))
        if cells:
            pairs = [pair for _, *cell in cells for pair in zip(*cell, strict=True)]
            passes = all(error < bound or error == bound == 0 for error, bound in pairs)
            texts = [*(_pair(worst.get(name, ())) for name in BACKENDS), _bounds({n: (*b,) for n, b in bounds.items()})]
            lines.append(f"| {family} | {' | '.join(texts)} | {'pass' if passes else 'fail'} |")
    return lines


COMPARED = "native", "gsplat"
COMPARED_BOUNDS = 1e-5, 1e-4
COMPARISON_HEADER = "| Family | Cases |" + "".join(f" {side}: worst | Not finite | Above |" for side in COMPARED)


def comparison(families):
    """A line for each family, and one for all, of the errors that `experiments/hard_cases_gsplat.py` writes.

    Of each side: the worst finite errors of value and gradient, the cases with an image and with a gradient that is not
    finite, and the cases with a finite error that is not below its bound.
    """
    total = {"all": {f"{family}: {name}": case for family, cases in families.items() for name, case in cases.items()}}
    lines = [COMPARISON_HEADER, "|---" * (2 + 3 * len(COMPARED)) + "|"]
    for family, cases in (families | total).items():
        cells = []
        for side in COMPARED:
            kinds = [*zip(*(case[side] for case in cases.values()), strict=True)]  # values, gradients
            worst = _pair([max(error for error in kind if error is not None) for kind in kinds])
            not_finite = ", ".join(str(kind.count(None)) for kind in kinds)
            cells += [worst, not_finite, str(sum(_is_above(case[side]) for case in cases.values()))]
        lines.append(f"| {family} | {len(cases)} | {' | '.join(cells)} |")
    return lines


def comparison_faults(families):
    """A line for each case in which gsplat has an error above its bound, or a result that is not finite."""
    return ["| Family | Case | Value | Gradient |", "|---|---|---|---|"] + [
        f"| {family} | {name} | {' | '.join('not finite' if e is None else _pair([e]) for e in case['gsplat'])} |"
        for family, cases in families.items()
        for name, case in cases.items()
        if None in case["gsplat"] or _is_above(case["gsplat"])
    ]


def _is_above(errors):
    pairs = zip(errors, COMPARED_BOUNDS, strict=True)
    return any(error is not None and error >= bound for error, bound in pairs)


def draw_comparison(families, file):
    """A panel each of value and gradient: a row a family, a dot a case and side; to the right of all, not finite."""
    from gsjax.io.files import atomic_path
    from gsjax.report.figures import new_figure

    figure = new_figure(10, 5)
    panels = figure.subplots(1, 2, sharey=True)
    not_finite = 1e3
    for place, (panel, name, bound) in enumerate(zip(panels, ("image", "gradient"), (1e-5, 1e-4), strict=True)):
        for side, marker, color, shift in (("native", "o", "C0", -0.16), ("gsplat", "x", "C3", 0.16)):
            dots = [
                (not_finite if case[side][place] is None else max(case[side][place], 1e-9), row + shift)
                for row, cases in enumerate(families.values())
                for case in cases.values()
            ]
            panel.scatter(*zip(*dots, strict=True), marker=marker, s=24, linewidths=1, color=color, label=side)
        panel.axvline(bound, color="0.5", linestyle="--", linewidth=1)
        panel.set_xscale("log")
        ticks = {1e-9: "0", 1e-7: "1e-7", 1e-5: "1e-5", 1e-3: "1e-3", 1e-1: "0.1", not_finite: "not\nfinite"}
        panel.set_xticks(list(ticks), list(ticks.values()))
        panel.set_xlabel(f"relative error of the {name}")
        panel.grid(axis="y", color="0.9")
        panel.set_axisbelow(True)
    panels[0].set_yticks(range(len(families)), [f"{family} ({len(cases)})" for family, cases in families.items()])
    panels[0].invert_yaxis()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)  # hides no case
    with atomic_path(file) as temporary:
        figure.savefig(temporary, dpi=150, format="png")
