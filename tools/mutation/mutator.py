"""Mutants of a source file: the same program with one small mistake each.

A mutant is named by its file, the function it is in, and the expression before and after, not by
its line: names stay the same while other lines change.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

Put = Callable[[Any], None]
"""Puts a node in the place of another."""
Change = Callable[[], None]

COMPARED: Final[dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
"""At the limit, and the other way round."""
COMPUTED: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitOr,
    ast.MatMult: ast.Mult,
}
SWAPPED: Final = {"min": "max", "max": "min", "any": "all", "all": "any"}
FLOAT_FACTOR: Final = 1.25
LARGE: Final = 1000
"""From here on a whole number is a quantity: it is changed by a quarter, not by one."""
PLAIN_DECORATORS: Final = frozenset({"property", "staticmethod", "classmethod", "setter"})
"""A function behind any other may have been taken apart already when it is called."""
UNTOUCHED: Final = frozenset({"__all__", "__slots__"})


class Where(NamedTuple):
    """The place of a node."""

    qualname: str
    """Of the outermost function, as its code object has it; empty in the body of module or
    class."""
    first_line: int
    """Of that function, decorators included."""
    is_plain: bool
    """Whether the function's code is looked up anew at each call."""
    lines: range
    """Of the statement, or of its head."""
    constants: tuple[str, ...] = ()
    """The names that a statement of the module's body binds, if nothing else there uses them."""


@dataclass(frozen=True)
class Mutant:
    """One small mistake. `apply` makes it in the tree of its file, `undo` takes it back."""

    name: str
    where: Where
    apply: Change
    undo: Change


class Mutants:
    """All mutants of one file."""

    def __init__(self, path: str, source: str) -> None:
        """path: as the names have it."""
        self.tree = ast.parse(source)
        self._path = path
        self._seen: Counter[str] = Counter()
        self._root: ast.AST = self.tree
        self.all: list[Mutant] = []
        self._used_at_once = _used_at_once(self.tree)
        self._body(self.tree.body, Where("", 0, False, range(0)), "")

    def _add(self, where: Where, apply: Change, undo: Change) -> None:
        """A mutant that is shown by the expression around it, before and after."""
        before = ast.unparse(self._root)
        apply()
        after = ast.unparse(self._root)
        undo()
        self._named(where, f"{_short(before)} => {_short(after)}", apply, undo)

    def _named(self, where: Where, change: str, apply: Change, undo: Change) -> None:
        name = f"{self._path}::{where.qualname or '-'}: {change}"
        self._seen[name] += 1
        if self._seen[name] > 1:
            name += f" #{self._seen[name]}"
        self.all.append(Mutant(name, where, apply, undo))

    def _set(self, where: Where, node: Any, field: str, new: Any) -> None:
        self._add(where, _setter(node, field, new), _setter(node, field, getattr(node, field)))

    # Statements

    def _body(self, body: list[ast.stmt], where: Where, scope: str) -> None:
        for k, statement in enumerate(body):
            is_docstring = isinstance(statement, ast.Expr) and isinstance(
                statement.value, ast.Constant
            )
            if not is_docstring:
                self._statement(statement, where, scope, _item_put(body, k))

    def _statement(self, node: ast.stmt, where: Where, scope: str, put: Put) -> None:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            self._function(node, where, scope)
        elif isinstance(node, ast.ClassDef):
            if not _is_enum(node):
                self._body(node.body, where, f"{scope}{node.name}.")
        elif isinstance(node, ast.Import | ast.ImportFrom | ast.Raise | ast.Assert):
            return
        elif isinstance(node, ast.If | ast.While):
            if not _is_for_types(node.test):
                here = where._replace(lines=_lines(node.test))
                self._condition(node, here)
                self._rooted(node.test, here, _field_put(node, "test"))
            self._body(node.body, where, scope)
            self._body(node.orelse, where, scope)
        elif isinstance(node, ast.For):
            here = where._replace(lines=_lines(node.iter))
            self._rooted(node.iter, here, _field_put(node, "iter"))
            self._body(node.body, where, scope)
        elif isinstance(node, ast.With):
            self._body(node.body, where, scope)
        elif isinstance(node, ast.Try):
            self._body(node.body, where, scope)
            for handler in node.handlers:
                self._body(handler.body, where, scope)
        else:
            here = where._replace(lines=_lines(node))
            if not where.qualname and not scope:
                here = here._replace(constants=self._constants(node))
            self._simple(node, here, put)

    def _constants(self, node: ast.stmt) -> tuple[str, ...]:
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            return ()
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = {each.id for target in targets for each in ast.walk(target)
                 if isinstance(each, ast.Name)}  # fmt: skip
        return () if names & self._used_at_once else tuple(sorted(names))

    def _function(
        self, node: ast.FunctionDef | ast.AsyncFunctionDef, where: Where, scope: str
    ) -> None:
        for values in (node.args.defaults, node.args.kw_defaults):
            for k, default in enumerate(values):
                if default is not None:
                    outside = where._replace(lines=_lines(default))
                    self._rooted(default, outside, _item_put(values, k))
        if not where.qualname:
            names = [each.attr if isinstance(each, ast.Attribute) else getattr(each, "id", "?")
                     for each in node.decorator_list]  # fmt: skip
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            where = Where(f"{scope}{node.name}", first, set(names) <= PLAIN_DECORATORS, range(0))
        self._body(node.body, where, "")

    def _condition(self, node: ast.If | ast.While, where: Where) -> None:
        if isinstance(node.test, ast.Compare | ast.UnaryOp):
            return  # turned round by its own mutants
        for value in (True, False):
            if isinstance(node, ast.If) or not value:
                new = ast.copy_location(ast.Constant(value), node.test)
                apply, undo = _setter(node, "test", new), _setter(node, "test", node.test)
                change = f"if {_short(ast.unparse(node.test))} => if {value}"
                self._named(where, change, apply, undo)

    def _simple(self, node: ast.stmt, where: Where, put: Put) -> None:
        self._root = node
        if isinstance(node, ast.AnnAssign | ast.Assign):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            if isinstance(target, ast.Name) and target.id in UNTOUCHED:
                return
            if isinstance(target, ast.Attribute | ast.Subscript) and where.qualname:
                self._deleted(node, where, put)
            if node.value is not None:
                self._expression(node.value, where, _field_put(node, "value"))
        elif isinstance(node, ast.AugAssign):
            self._deleted(node, where, put)
            self._set(where, node, "op", COMPUTED[type(node.op)]())
            self._expression(node.value, where, _field_put(node, "value"))
        elif isinstance(node, ast.Return):
            if node.value is not None and not isinstance(node.value, ast.Constant):
                none = ast.copy_location(ast.Constant(None), node.value)
                self._set(where, node, "value", none)
            if node.value is not None:
                self._expression(node.value, where, _field_put(node, "value"))
        elif isinstance(node, ast.Expr):
            self._deleted(node, where, put)
            self._expression(node.value, where, _field_put(node, "value"))
        elif isinstance(node, ast.Break | ast.Continue | ast.Delete):
            self._deleted(node, where, put)

    def _deleted(self, node: ast.stmt, where: Where, put: Put) -> None:
        nothing = ast.copy_location(ast.Pass(), node)
        change = f"{_short(ast.unparse(node))} => pass"
        self._named(where, change, _putting(put, nothing), _putting(put, node))

    # Expressions

    def _rooted(self, node: ast.expr, where: Where, put: Put) -> None:
        """An expression that is shown by itself; `put` is for its parts, so it is wrapped."""
        holder = ast.Expr(node)

        def put_both(new: Any) -> None:
            put(new)
            holder.value = new

        self._root = holder
        self._expression(node, where, put_both)

    def _expression(self, node: ast.AST, where: Where, put: Put) -> None:
        if isinstance(node, ast.JoinedStr):
            return
        for mutated in _replacements(node):
            self._add(where, _putting(put, mutated), _putting(put, node))
        if isinstance(node, ast.Compare):
            for k, operator in enumerate(node.ops):
                for other in COMPARED[type(operator)]:
                    self._add(where, _setting(node.ops, k, other()),
                              _setting(node.ops, k, operator))  # fmt: skip
        for field, value in ast.iter_fields(node):
            if field == "annotation":
                continue
            if isinstance(value, ast.expr | ast.comprehension | ast.keyword | ast.Slice):
                self._expression(value, where, _field_put(node, field))
            elif isinstance(value, list):
                for k, each in enumerate(value):
                    if isinstance(each, ast.expr | ast.comprehension | ast.keyword):
                        self._expression(each, where, _item_put(value, k))


def _replacements(node: ast.AST) -> Iterator[ast.AST]:
    """What an expression may be replaced by."""
    new: list[ast.AST] = []
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        new.append(node.operand)
    elif isinstance(node, ast.BoolOp):
        other = ast.And() if isinstance(node.op, ast.Or) else ast.Or()
        new.append(ast.BoolOp(other, node.values))
    elif isinstance(node, ast.BinOp):
        if not isinstance(node.left, ast.Constant) or not isinstance(node.left.value, str):
            new.append(ast.BinOp(node.left, COMPUTED[type(node.op)](), node.right))
    elif isinstance(node, ast.IfExp):
        new.append(ast.IfExp(node.test, node.orelse, node.body))
    elif isinstance(node, ast.Name) and node.id in SWAPPED:
        new.append(ast.Name(SWAPPED[node.id], ast.Load()))
    elif isinstance(node, ast.Constant):
        new += [ast.Constant(value) for value in _other_values(node.value)]
    for each in new:
        yield ast.copy_location(each, node)


def _other_values(value: Any) -> list[Any]:
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, int) and value >= LARGE:
        return [value * 5 // 4, value * 3 // 4]
    if isinstance(value, int):
        return [value + 1] if value <= 0 else [value + 1, value - 1]
    if isinstance(value, float):
        return [value * FLOAT_FACTOR if value else 1.0]
    return []


def _used_at_once(tree: ast.Module) -> set[str]:
    """Names that are read while the module is loaded: in its body, those of its classes, and the
    heads of functions."""
    found: set[str] = set()
    waiting: list[ast.AST] = list(tree.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            found.add(node.id)
        for field, value in ast.iter_fields(node):
            is_later = field == "body" and isinstance(node, ast.FunctionDef | ast.Lambda)
            if not is_later and field not in ("annotation", "returns"):
                parts = value if isinstance(value, list) else [value]
                waiting += [part for part in parts if isinstance(part, ast.AST)]
    return found


def _is_enum(node: ast.ClassDef) -> bool:
    """Its members are names: what matters of their values is held against the DBC by tests."""
    return any("Enum" in ast.unparse(base) for base in node.bases)


def _is_for_types(test: ast.expr) -> bool:
    return isinstance(test, ast.Name) and test.id == "TYPE_CHECKING"


def _lines(node: Any) -> range:
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def _short(text: str) -> str:
    return " ".join(text.split())


def _field_put(node: Any, field: str) -> Put:
    return lambda new: setattr(node, field, new)


def _item_put(items: list[Any], k: int) -> Put:
    def put(new: Any) -> None:
        items[k] = new

    return put


def _setter(node: Any, field: str, value: Any) -> Change:
    return lambda: setattr(node, field, value)


def _putting(put: Put, node: ast.AST) -> Change:
    return lambda: put(node)


def _setting(items: list[Any], k: int, value: Any) -> Change:
    def put() -> None:
        items[k] = value

    return put
