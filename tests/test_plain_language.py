"""Names and docstrings in plain words: the limits and the exceptions are in plain_words.toml."""

import ast
import re
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator

import pytest

from tests.sources import PACKAGES, TOP, parse_package

RULES = tomllib.loads((TOP / "tests" / "plain_words.toml").read_text(encoding="utf-8"))
WORDS = set(RULES["words"].split())
FRAGMENTS = set(RULES["fragments"].split())


def limit_of(kind: str, package: str) -> int:
    """Return the limit of a package: the goal, or what it still has while it is being cleaned."""
    limit: int = RULES["now"].get(package, {}).get(kind, RULES["goal"][kind])
    return limit


def assigned_names(tree: ast.Module) -> Iterator[str]:
    """Yield the names of functions, arguments, classes, variables and attributes."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef():
                yield node.name
                yield from (argument.arg for argument in [*node.args.args, *node.args.kwonlyargs])
            case ast.ClassDef():
                yield node.name
            case ast.Name(ctx=ast.Store()):
                yield node.id
            case ast.Attribute(ctx=ast.Store()):
                yield node.attr


def docstrings(tree: ast.Module) -> Iterator[str]:
    """Yield the texts under modules, classes, functions and constants."""
    for node in ast.walk(tree):
        documented = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module
        if isinstance(node, documented) and (text := ast.get_docstring(node)):
            yield text
        if isinstance(node, ast.ClassDef | ast.Module):
            for first, second in zip(node.body, node.body[1:], strict=False):
                match first, second:
                    case (
                        ast.Assign() | ast.AnnAssign(),
                        ast.Expr(value=ast.Constant(value=str(text))),
                    ):
                        yield text


def words_of(name: str) -> set[str]:
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)}


@pytest.mark.parametrize("package", [*PACKAGES, "tests"])
def test_names_are_of_plain_words(package: str) -> None:
    names = [name for tree in parse_package(package).values() for name in assigned_names(tree)]
    hits = Counter(
        name for name in names if name not in RULES["accepted"] and WORDS & words_of(name)
    )
    limit = limit_of("words", package) * len(names) / 1000
    assert hits.total() <= limit, f"most frequent: {hits.most_common(20)}"


@pytest.mark.parametrize("package", [*PACKAGES, "tests"])
def test_docstrings_begin_with_a_subject_or_a_verb(package: str) -> None:
    texts = [text for tree in parse_package(package).values() for text in docstrings(tree)]
    fragments = [text for text in texts if re.split(r"\W", text.strip())[0] in FRAGMENTS]
    assert len(fragments) <= limit_of("fragments", package) * len(texts) / 100, fragments[:20]


@pytest.mark.parametrize("package", PACKAGES)
def test_a_constant_has_a_single_meaning_in_a_package(package: str) -> None:
    values: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for file, tree in parse_package(package).items():
        for node in tree.body:
            match node:
                case (
                    ast.Assign(targets=[ast.Name(id=name)], value=value)
                    | ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value)
                ) if name.isupper():
                    place = file.relative_to(TOP).as_posix()
                    values[name.lstrip("_")][ast.unparse(value)].append(place)
    ambiguous = {name: dict(meanings) for name, meanings in values.items() if len(meanings) > 1}
    assert len(ambiguous) <= limit_of("ambiguous_constants", package), ambiguous


def test_every_exception_is_used() -> None:
    trees = [tree for package in PACKAGES for tree in parse_package(package).values()]
    names = {name for tree in trees for name in assigned_names(tree)}
    assert set(RULES["accepted"]) <= names
