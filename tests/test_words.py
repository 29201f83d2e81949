"""Texts use the standard terms of the field, and no name is a bare participle."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

CHECKED = ("CONTRIBUTING.md", "README.md", "docs", "experiments", "gsjax", "rasterizer")
"""Folders and files whose docstrings, pages and help texts have no word of `WORDS`, and no name of `PARTICIPLES`."""

WORDS = {
    r"held back|holding back|holds? back": "sparse-view regularization",
    r"(learned|learns?) by heart": "overfits",
    r"own normals": "self-supervised normals",
    r"(look|looks|looked|looking) (at|for)": "inspect, search",
    r"(ask|asks|asked|call|calls|called) for": "require, request",
    r"takes? in": "enables",
    r"learned light|light of the mean photo|near gains": "exposure-corrected",
    r"nobody|whoever": "no process, users who",
    r"settles?|settled|settling": "photometric vertex refinement",
    r"knobs?": "setting",
    r"(go|goes|going|went) on": "resume, continue",
    r"whole road|the road": "pipeline",
    r"tells?|telling|told(?! apart)": "report, indicate, imply",
    r"does not count|do not count": "has weight 0",
    r"beside": "next to, and",
    r"agree[sd]?(?! with gsplat)": "is consistent, fits",
    r"prior(?! focal)": "normal maps",
    r"stood|stands? (in )?for(?! the data| it| a vec| any)": "is, means",
    r"dear": "expensive, of surface terms",
    r"trials?": "validation run",
    r"handed (in|out)?|hands (in|out)|at hand": "passed, given",
    r"strays?": "outlier",
    r"sure": "confident, significant",
    r"(bring|brings|brought|bringing) (back|up)": "restore",
}
"""Pattern of a private word or phrase -> what to write."""

PARTICIPLES = {
    "asked", "begun", "chosen", "drawn", "found", "given", "held", "judged", "kept", "known", "looked", "looking",
    "made", "said", "seen", "shown", "stretched", "taken", "told", "tried", "wanted", "written",
}  # fmt: skip


def checked(suffix: str) -> list[Path]:
    """The files of `CHECKED` with a suffix, without the results of studies."""
    places = [ROOT / place for place in CHECKED]
    files = [file for place in places for file in (sorted(place.rglob("*")) if place.is_dir() else [place])]
    return [file for file in files if file.suffix == suffix and file.parent.name != "results"]


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def texts(path: Path) -> list[str]:
    """Docstrings, messages and help of a module: its strings with a space. Of a page its prose, without code."""
    if path.suffix == ".md":
        return [re.sub(r"^```.*?^```$|^ {4}.*?$|`[^`\n]*`", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)]
    strings = [str(node.value) for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)]
    return [re.sub(r"`[^`\n]*`", "", text) for text in strings if " " in text]


def private_words(path: Path) -> list[str]:
    """Each private word of a file, with what to write."""
    text = "\n".join(texts(path))
    return [f"{hit[0]!r}: {term}" for word, term in WORDS.items() for hit in re.finditer(rf"\b({word})\b", text, re.I)]


def names_of(path: Path) -> set[str]:
    """Names of a module, and of its functions, classes, parameters and variables, without underscores around them."""
    names = {path.stem}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.arg):
            names.add(node.arg)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
    return {name.strip("_").lower() for name in names}


def test_texts_use_the_terms_of_the_field():
    faults = {named(path): private_words(path) for path in [*checked(".py"), *checked(".md")]}
    assert not {path: words for path, words in faults.items() if words}


def test_no_name_is_a_bare_participle():
    faults = {}
    for path in [*checked(".py"), *sorted((ROOT / "tests").rglob("*.py"))]:
        faults[named(path)] = names_of(path) & PARTICIPLES
        # `Blended` is a record of the compiled loops, which a rename would compile anew.
        faults[named(path)] |= {*re.findall(r"^ *class _?(?!Blended)[A-Z][a-z]+ed\b", path.read_text(), re.MULTILINE)}
    assert not {path: names for path, names in faults.items() if names}
