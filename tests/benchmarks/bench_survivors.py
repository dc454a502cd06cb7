"""Random changes of the code: how many of them the fast tier notices, and its branch coverage.

Not part of the test run. It needs the package `coverage`. From the repository:

    python tests/benchmarks/bench_survivors.py [--count N] [--seed N] [--rooms ROOM ...]
        [--tree DIR] [--work DIR]

First the fast tier runs once, with the tests that compile the numba engine, and it is kept which
tests execute which line (an hour on a slow machine; kept in `--work` for the next time). Then each
of N changes of an operator, a constant or a boundary in `models`, `results`, `tasks`, `video` and
`live`, or the rooms that are named, is made in a copy of the tree, and the tests that execute it
run until the first one fails. If none does, the other tests of their files run, too. What no test
notices survives.

A change is known by its function, its statement and what it puts there, not by its place, and the
draw goes by a hash of that: code that only moves to another file is changed in the same way. A
change after which the program does the same as before is named in `EQUIVALENT`, and another one
is drawn.
"""

import argparse
import ast
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGE, ROOMS = "dlgmd_cli", ("models", "results", "tasks", "video", "live")
LEFT_OUT = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".*_cache", ".hypothesis")
COVERAGE, DURATIONS = "coverage.data", "durations.json"
# What more tests than these execute, is not only executed while something is prepared for them.
MANY = 40
# Of changes that do nothing: the change, as it is printed, and why.
EQUIVALENT = {
    "_where: low, high = (middle, high) if at_most(most, middle) > probability else (low, middle)"
    " | at_most(most, middle) > probability -> at_most(most, middle) >= probability": (
        "halving an interval comes to the same end on either side of equality"
    ),
    "session_on: for model, size_wh in zip(models, sizes_wh, strict=True): | True -> False": (
        "both lists have an entry for each setup"
    ),
    "differences: n_more, n_fewer = (int(more[more > 0].sum()), int(-more[more < 0].sum()))"
    " | more > 0 -> more >= 0": "zeros add nothing to a sum",
}

COMPARISONS = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
}
OTHER_FUNCTIONS = {"min": "max", "max": "min", "any": "all", "all": "any"}
OTHER_FUNCTIONS |= {"minimum": "maximum", "maximum": "minimum", "floor": "ceil", "ceil": "floor"}


@dataclass(frozen=True)
class Mutant:
    """A change of one expression of a file.

    `line` is where its statement begins and `last_line` where the expression ends, `names` are
    those by which it is known outside of functions. `start` and `end` are places in the file's
    bytes, between which `new` is put.
    """

    file: str
    function: str
    statement: str
    old: str
    new: str
    number: int
    line: int
    last_line: int
    start: int
    end: int
    names: tuple[str, ...]

    @property
    def key(self) -> str:
        """What the draw goes by: where the code stands plays no part."""
        again = f" ({self.number + 1})" if self.number else ""
        return f"{self.function}: {self.statement} | {self.old} -> {self.new}{again}"

    def rank(self, seed: int) -> str:
        """The least ones are drawn."""
        return hashlib.sha256(f"{seed}|{self.key}".encode()).hexdigest()


def changed(node: ast.AST) -> Iterator[ast.expr]:
    """The changes of an expression itself, not of its parts."""
    if isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            if type(operator) in COMPARISONS:
                ops = [*node.ops]
                ops[place] = COMPARISONS[type(operator)]()
                yield ast.Compare(node.left, ops, node.comparators)
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        yield ast.BinOp(node.left, OPERATORS[type(node.op)](), node.right)
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield ast.Constant(node.value + 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float):
        yield ast.Constant(1.25 * node.value or 1.0)
    elif isinstance(node, ast.Name) and node.id in OTHER_FUNCTIONS:
        yield ast.Name(OTHER_FUNCTIONS[node.id], node.ctx)
    elif isinstance(node, ast.Attribute) and node.attr in OTHER_FUNCTIONS:
        yield ast.Attribute(node.value, OTHER_FUNCTIONS[node.attr], node.ctx)


class Finder(ast.NodeVisitor):
    """Collects the changes of a file, without those of annotations, decorators and texts."""

    def __init__(self, file: str, content: bytes) -> None:
        self.file, self.mutants = file, list[Mutant]()
        self._starts = [0]
        for line in content.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        self._functions, self._names = list[str](), list[str]()
        self._statement: ast.stmt | None = None
        self._counts: Counter[tuple[str, ...]] = Counter()
        self.visit(ast.parse(content))

    def visit(self, node: ast.AST) -> None:
        """Take in a node and what is below it."""
        if isinstance(node, ast.JoinedStr):  # whose places Python does not tell before 3.12
            return
        if isinstance(node, ast.stmt):
            self._statement = node
        if isinstance(node, ast.expr) and self._statement is not None:
            for other in changed(node):
                self._add(node, other)
        super().visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Its defaults belong to it, its decorators and annotations are left out."""
        self._functions.append(node.name)
        for default in [*node.args.defaults, *node.args.kw_defaults]:
            if default is not None:
                self.visit(default)
        for statement in node.body:
            self.visit(statement)
        self._functions.pop()

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        """What stands in its body is known by its name."""
        self._names.append(node.name)
        for statement in node.body:
            self.visit(statement)
        self._names.pop()

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        """Only the value."""
        if node.value is not None:
            self.visit(node.value)

    def _add(self, node: ast.expr, other: ast.expr) -> None:
        statement, old, new = self._statement, ast.unparse(node), ast.unparse(other)
        assert statement is not None and node.end_lineno and node.end_col_offset is not None
        function = self._functions[-1] if self._functions else "<module>"
        text = " ".join(ast.unparse(statement).split("\n")[0].split())
        if isinstance(statement, ast.FunctionDef):
            text = "its defaults"
        known = function, text, old, new
        targets = getattr(statement, "targets", [getattr(statement, "target", None)])
        assigned = [
            name.id
            for target in targets
            for name in (target.elts if isinstance(target, ast.Tuple) else [target])
            if isinstance(name, ast.Name)
        ]
        names = [] if self._functions else [*self._names[-1:], *assigned]
        self.mutants.append(
            Mutant(
                file=self.file,
                function=function,
                statement=text,
                old=old,
                new=new,
                number=self._counts[known],
                line=statement.lineno,
                last_line=node.end_lineno,
                start=self._starts[node.lineno - 1] + node.col_offset,
                end=self._starts[node.end_lineno - 1] + node.end_col_offset,
                names=tuple(names),
            )
        )
        self._counts[known] += 1


def all_mutants(tree: Path, rooms: Iterable[str] = ROOMS) -> list[Mutant]:
    """Every change that can be made in the rooms."""
    found = []
    for room in rooms:
        for path in sorted((tree / PACKAGE / room).rglob("*.py")):
            found += Finder(str(path.relative_to(tree)), path.read_bytes()).mutants
    return found


# As a plugin of pytest (`-p bench_survivors`), while coverage is measured.


def pytest_runtest_protocol(item: object) -> None:
    """What runs from here on is counted for this test, its fixtures as well."""
    import coverage

    now = coverage.Coverage.current()
    if now is not None:
        now.switch_context(item.nodeid)  # type: ignore[attr-defined]


def pytest_terminal_summary(terminalreporter: object) -> None:
    """Keep how long each test took; one that fails without a change shows nothing."""
    place = os.environ.get("DLGMD_DURATIONS")
    if place:
        stats = terminalreporter.stats  # type: ignore[attr-defined]
        failed = {report.nodeid for end in ("failed", "error") for report in stats.get(end, [])}
        durations: dict[str, float] = defaultdict(float)
        for reports in stats.values():
            for report in reports:
                if hasattr(report, "duration") and report.nodeid not in failed:
                    durations[report.nodeid] += report.duration
        Path(place).write_text(json.dumps(durations), encoding="utf-8")


def environment(tree: Path, **more: str) -> dict[str, str]:
    """For processes with the code of a tree, which leave nothing in it."""
    here = str(Path(__file__).parent)
    paths = [str(tree), here, os.environ.get("PYTHONPATH", "")]
    settings = {"PYTHONPATH": os.pathsep.join(filter(None, paths)), "PYTHONDONTWRITEBYTECODE": "1"}
    return {**os.environ, **settings, **more}


def measure(tree: Path, work: Path) -> None:
    """Run the fast tier once, with the lines that each test executes."""
    data = f"--data-file={work / COVERAGE}"
    end = subprocess.run(
        [
            *(sys.executable, "-m", "coverage", "run", "--branch", f"--source={PACKAGE}", data),
            *("-m", "pytest", "-q", "-p", "no:xdist", "-p", "no:cacheprovider"),
            *("-p", "bench_survivors", "tests/unit", "tests/system/test_engines_agree.py"),
        ],
        cwd=tree,
        env=environment(tree, DLGMD_DURATIONS=str(work / DURATIONS)),
        check=False,
    )
    if end.returncode > 1:
        raise RuntimeError(f"the fast tier ended with {end.returncode}")


class Tests:
    """Which tests execute what, and how long they take."""

    def __init__(self, tree: Path, work: Path) -> None:
        from coverage import Coverage, CoverageData

        self._tree, data = tree, CoverageData(str(work / COVERAGE))
        data.read()
        self._by_line = {
            str(Path(path).relative_to(tree)): data.contexts_by_lineno(path)
            for path in data.measured_files()
            if path.endswith(".py")
        }
        self.durations: dict[str, float] = json.loads((work / DURATIONS).read_text("utf-8"))
        report = Coverage(data_file=str(work / COVERAGE), branch=True)
        report.load()
        report.json_report(outfile=str(work / "coverage.json"))
        self.totals = json.loads((work / "coverage.json").read_text("utf-8"))["totals"]

    def of(self, mutant: Mutant) -> set[str]:
        """Tests that execute the mutant; outside of functions, what mentions its names."""
        lines = self._by_line.get(mutant.file, {})
        found = {
            test
            for number in range(mutant.line, mutant.last_line + 1)
            for test in lines.get(number, [])
        }
        for name in mutant.names:
            found |= self._mentioning(name)
        if mutant.file.endswith("engines/numba.py"):  # compiled functions are not seen
            found |= {test for tests in lines.values() for test in tests}
        return found & self.durations.keys()

    def _mentioning(self, name: str) -> set[str]:
        found = set[str]()
        for file, lines in self._by_line.items():
            for node in ast.walk(ast.parse((self._tree / file).read_bytes())):
                if name in (getattr(node, "id", None), getattr(node, "attr", None)):
                    found.update(lines.get(getattr(node, "lineno", 0), []))
        return found

    def beside(self, tests: set[str]) -> set[str]:
        """The other tests of their files, which may share what one of them has prepared.

        None if they are so many that it is not only prepared.
        """
        if len(tests) > MANY:
            return set()
        files = {test.split("::")[0] for test in tests}
        return {test for test in self.durations if test.split("::")[0] in files} - tests

    def ordered(self, tests: set[str]) -> list[str]:
        """Those of a file one after the other, the quickest files first."""
        total: dict[str, float] = defaultdict(float)
        for test in tests:
            total[test.split("::")[0]] += self.durations[test]
        return sorted(tests, key=lambda test: (total[test.split("::")[0]], test.split("::")[0]))


def failing(tree: Path, tests: list[str], limit_s: float) -> str:
    """The first of the tests that fails; empty if none does, "(hangs)" after the limit."""
    with tempfile.NamedTemporaryFile("w", suffix=".txt", encoding="utf-8") as names:
        # A name with the tree's path, or that needs two lines, is of another test in the copy.
        known = (re.sub(r"\[.*[/\n].*", "", test, flags=re.DOTALL) for test in tests)
        names.write("\n".join(dict.fromkeys(known)))
        names.flush()
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:xdist"]
        command += ["-p", "no:cacheprovider", "--tb=no", "-rfE", f"@{names.name}"]
        with subprocess.Popen(
            command,
            cwd=tree,
            env=environment(tree),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        ) as process:
            try:
                output, _ = process.communicate(timeout=limit_s)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, 9)
                return "(hangs)"
    if process.returncode == 0:
        return ""
    if process.returncode < 0:
        return f"(the process ends by signal {-process.returncode})"
    if "while loading conftest" in output:
        return "(the package cannot be imported)"
    # Of a file of tests that cannot be imported only the summary tells, not the exit status.
    lines = [one for one in output.splitlines() if one.startswith(("FAILED ", "ERROR tests/"))]
    if not lines:
        raise RuntimeError(f"pytest ended with {process.returncode}: {output[-2000:]}")
    return lines[0].split(" ", 1)[1].split(" - ")[0]


def killer(mutant: Mutant, tree: Path, tests: Tests) -> str:
    """The test that notices the mutant, which is made in a copy of the tree; empty if none does."""
    path = tree / mutant.file
    content = path.read_bytes()
    new = b"(" + mutant.new.encode() + b")"
    path.write_bytes(content[: mutant.start] + new + content[mutant.end :])
    try:
        executing = tests.of(mutant)
        for some in (executing, tests.beside(executing)):
            if some:
                limit_s = 120.0 + 5.0 * sum(tests.durations[test] for test in some)
                if found := failing(tree, tests.ordered(some), limit_s):
                    return found
        return ""
    finally:
        path.write_bytes(content)


def main() -> None:
    """Measure what is not measured yet, draw, and print a line for each mutant."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--rooms", nargs="+", default=ROOMS)
    parser.add_argument("--tree", type=Path, default=ROOT)
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "survivors")
    parser.add_argument("--list", action="store_true", help="only print what is drawn")
    given = parser.parse_args()
    tree, work = given.tree.resolve(), given.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    possible = all_mutants(tree, given.rooms)
    possible.sort(key=lambda one: (one.rank(given.seed), one.file))
    drawn = [one for one in possible if one.key not in EQUIVALENT][: given.count]
    print(f"{len(possible)} changes are possible; seed {given.seed} draws {len(drawn)}")
    if given.list:
        for mutant in drawn:
            print(f"{mutant.file}:{mutant.line}: {mutant.key}")
        return
    if not (work / DURATIONS).exists():
        measure(tree, work)
    tests = Tests(tree, work)
    survivors = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "tree"
        shutil.copytree(tree, copy, ignore=LEFT_OUT)
        for number, mutant in enumerate(drawn, start=1):
            began = time.monotonic()
            n_tests, found = len(tests.of(mutant)), killer(mutant, copy, tests)
            if not found:
                survivors.append(mutant)
            end = found or ("SURVIVES" if n_tests else "SURVIVES, as no test executes it")
            print(f"{number:3} {mutant.file}:{mutant.line}: {mutant.key}")
            took_s = time.monotonic() - began
            print(f"      {n_tests} tests, {took_s:.0f} s: {end}", flush=True)
    print(f"\n{len(drawn) - len(survivors)} of {len(drawn)} are noticed; these are not:")
    for mutant in survivors:
        print(f"  {mutant.file}:{mutant.line}: {mutant.key}")
    totals = tests.totals
    branches = totals["covered_branches"] / totals["num_branches"]
    print(
        f"Coverage of the package: {totals['percent_covered']:.2f} % of lines and branches; "
        f"{totals['covered_lines']} of {totals['num_statements']} statements, "
        f"{totals['covered_branches']} of {totals['num_branches']} branches ({branches:.2%})"
    )


if __name__ == "__main__":
    main()
