"""Machine code of straight-line Python functions of numbers and arrays, by LLVM directly.

The equations of a motor are generated as functions without loops or branches. numba needs seconds to infer their types;
here every value is a float64, so a walk over the syntax tree is enough, and a structure that is merely tried costs a
tenth of a second. The functions are handed to numba's compiled loop as first-class functions, by numba's wrapper address
protocol, and the object code is kept in the cache folder.

Understood are assignments, + - * / **, comparisons, conditional expressions, subscripts, min, max, abs, np.sign, the
functions of C's math library, and calls of the functions above in the same source, which are written out in place. A row
of numbers, `np.zeros(12)` or that of a matrix, `a[0, 0:12]`, may be filled at constant places, scaled, added, multiplied
element by element, and stored as a row of a matrix: one vector.
"""

import ast
import ctypes
import hashlib
import math
import os
import re
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
from llvmlite import ir
from numba.core import types
from numba.core.registry import cpu_target
from numba.core.typing import Signature

from motorlens_physics.compile.types import fastmath
from motorlens_runtime.errors import ModelError

# One thread at a time: Python's parser counts its depth for all threads together and fails where two parse at once (CPython
# 3.11, issue 106905), and a second thread that wants the same code finds it made.
_COMPILING = threading.Lock()
_DOUBLE, _INTEGER = ir.DoubleType(), ir.IntType(64)
# What the processor has itself, or LLVM knows how to expand.
_INTRINSICS = {"sqrt": "llvm.sqrt", "fabs": "llvm.fabs", "floor": "llvm.floor"}
_OPERATORS = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}


class Native(types.WrapperAddressProtocol):
    """Machine code at an address, which numba's compiled functions can be given and call."""

    def __init__(self, address: int, signature: Signature, engine: Any) -> None:
        """Keep the engine alive, which owns the code."""
        self._address, self._signature, self._engine = address, signature, engine
        self._numba_type_ = types.FunctionType(signature)

    def __wrapper_address__(self) -> int:
        return self._address

    def signature(self) -> Signature:
        """Types of arguments and result."""
        return self._signature


def native(
    source: str, signatures: Mapping[str, Signature], folder: Path, flags: Sequence[str] = fastmath
) -> dict[str, Native]:
    """Functions of a source as machine code, those with a signature.

    Args:
        source: functions, each using only those above it; `import`s are not needed.
        signatures: numba types of the arguments (float64, C-contiguous arrays) and of the result.
        folder: where object code is kept.
        flags: LLVM's liberties with the rules of arithmetic; none: every operation as it is written.

    Raises:
        ModelError: the source uses something that is not understood.
    """
    for function in {"pow", *re.findall(r"\bmath\.(\w+)\(", source)}:
        _announce(function)
    target = _target()
    made_by = (
        llvmlite.__version__,
        target.triple,
        llvm.get_host_cpu_name(),
        _features(),
        str(signatures),
        str(flags),
    )
    name = hashlib.sha256("\n".join((source, *made_by)).encode()).hexdigest()[:24]
    path = folder / f"motorlens_{name}.o"
    with _COMPILING:
        if path.exists():
            code = path.read_bytes()
        else:
            code = target.emit_object(_optimised(_module(source, signatures, target, flags), target))
            # Written aside and moved into place: another process never reads half a file.
            handle, aside = tempfile.mkstemp(dir=folder, suffix=".tmp")
            with os.fdopen(handle, "wb") as file:
                file.write(code)
            os.replace(aside, path)
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return {
        function: Native(engine.get_function_address(function), signature, engine)
        for function, signature in signatures.items()
    }


def _target() -> Any:
    """A description of this processor, which an engine takes into its possession."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    triple = llvm.get_process_triple()
    # As numba does: code for x86 is loaded where it will stay.
    reloc = "static" if triple.startswith(("x86", "i386", "i686", "amd64")) else "default"
    return llvm.Target.from_triple(triple).create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=_features(),
        opt=2,
        reloc=reloc,
        codemodel="jitdefault",
        jit=True,
    )


@cache
def _features() -> str:
    return str(llvm.get_host_cpu_features().flatten())


def _optimised(module: ir.Module, target: Any) -> Any:
    parsed = llvm.parse_assembly(str(module))
    builder = llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options(speed_level=2))
    builder.getModulePassManager().run(parsed, builder)
    return parsed


def _module(source: str, signatures: Mapping[str, Signature], target: Any, flags: Sequence[str]) -> ir.Module:
    module = ir.Module("motorlens")
    module.triple, module.data_layout = target.triple, str(target.target_data)
    functions = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)}
    context = cpu_target.target_context
    # Numba loads what it knows of first-class functions when it first compiles something.
    context.refresh()
    for name, signature in signatures.items():
        arguments = [context.get_value_type(of) for of in signature.args]
        of_it = ir.FunctionType(context.get_value_type(signature.return_type), arguments)
        function = ir.Function(module, of_it, name)
        builder = ir.IRBuilder(function.append_basic_block())
        names = [argument.arg for argument in functions[name].args.args]
        given = {
            argument: _argument(builder, value, of)
            for argument, value, of in zip(names, function.args, signature.args, strict=True)
        }
        result = _Writer(module, builder, functions, flags).body(functions[name], given)
        if result is None:
            # What numba returns for None.
            result = context.get_dummy_value()
        elif isinstance(result, list):
            packed = ir.Constant(of_it.return_type, ir.Undefined)
            for k, value in enumerate(result):
                packed = builder.insert_value(packed, value, k)
            result = packed
        builder.ret(result)
    return module


@dataclass(frozen=True)
class _Array:
    """Where an array's elements are, and how many there are along each axis."""

    data: Any
    shape: list[Any]


def _argument(builder: ir.IRBuilder, value: Any, of: Any) -> Any:
    if not isinstance(of, types.Array):
        return value
    model = cpu_target.target_context.data_model_manager[of]
    shape = builder.extract_value(value, model.get_field_position("shape"))
    data = builder.extract_value(value, model.get_field_position("data"))
    return _Array(data, [builder.extract_value(shape, axis) for axis in range(of.ndim)])


class _Writer:
    """Writes the statements of a function, one after another, into a block."""

    def __init__(
        self, module: ir.Module, builder: ir.IRBuilder, functions: Mapping[str, ast.FunctionDef],
        flags: Sequence[str],
    ) -> None:  # fmt: skip
        self._module, self._builder, self._functions, self._flags = module, builder, functions, flags

    def body(self, function: ast.FunctionDef, values: dict[str, Any]) -> Any:
        """Write a function with its arguments bound; its result, a list if it returns a tuple."""
        for statement in function.body:
            if isinstance(statement, ast.Return) and statement.value is not None:
                return self._value(statement.value, values)
            if isinstance(statement, ast.Assign):
                self._assign(statement.targets[0], self._value(statement.value, values), values)
            elif isinstance(statement, ast.AugAssign):
                both = ast.BinOp(statement.target, statement.op, statement.value)
                self._assign(statement.target, self._value(both, values), values)
            elif not isinstance(statement, ast.Pass):
                raise _unknown(statement)
        return None

    def _assign(self, target: ast.expr, value: Any, values: dict[str, Any]) -> None:
        if isinstance(target, ast.Name):
            values[target.id] = value
        elif (
            isinstance(target, ast.Subscript)
            and isinstance(target.slice, ast.Constant)
            and self._is_row(target, values)
        ):
            name = target.value.id  # type: ignore[attr-defined]
            at = ir.Constant(ir.IntType(32), target.slice.value)
            values[name] = self._builder.insert_element(values[name], value, at)
        elif isinstance(target, ast.Subscript) and isinstance(getattr(value, "type", None), ir.VectorType):
            # A row of a matrix: where its first number stands. Numbers are aligned, rows need not be.
            row, _ = target.slice.elts  # type: ignore[attr-defined]
            first = ast.Subscript(target.value, ast.Tuple([row, ast.Constant(0)]))
            place = self._builder.bitcast(self._place(first, values), value.type.as_pointer())
            self._builder.store(value, place, align=8)
        elif isinstance(target, ast.Subscript):
            self._builder.store(value, self._place(target, values))
        elif isinstance(target, ast.Tuple):
            if isinstance(value, _Array):
                value = [self._load(value, k) for k in range(len(target.elts))]
            for element, one in zip(target.elts, value, strict=True):
                self._assign(element, one, values)
        else:
            raise _unknown(target)

    def _value(self, node: ast.expr, values: dict[str, Any]) -> Any:
        builder = self._builder
        match node:
            case ast.Constant(value=float() | int()):
                return ir.Constant(_DOUBLE, float(node.value))  # type: ignore[arg-type]
            case ast.Name():
                return values[node.id]
            case ast.Attribute(value=ast.Name(id="math"), attr=("pi" | "e" | "inf" | "nan") as name):
                return ir.Constant(_DOUBLE, getattr(math, name))
            case ast.Tuple():
                return [self._value(element, values) for element in node.elts]
            case ast.Subscript(
                slice=ast.Tuple(
                    elts=[row, ast.Slice(ast.Constant(value=0), ast.Constant(value=int(width)), None)]
                )
            ):
                first = ast.Subscript(node.value, ast.Tuple([row, ast.Constant(0)]))
                of = ir.VectorType(_DOUBLE, width).as_pointer()
                return builder.load(builder.bitcast(self._place(first, values), of), align=8)
            case ast.Subscript():
                return builder.load(self._place(node, values))
            case ast.UnaryOp(op=ast.USub()):
                return builder.fneg(self._value(node.operand, values), flags=self._flags)
            case ast.BinOp(op=ast.Pow()):
                return self._power(self._value(node.left, values), node.right, values)
            case ast.BinOp() if type(node.op) in _OPERATORS:
                write = getattr(builder, _OPERATORS[type(node.op)])
                pair = self._alike(self._value(node.left, values), self._value(node.right, values))
                return write(*pair, flags=self._flags)
            case ast.IfExp():
                test, yes, no = (self._value(part, values) for part in (node.test, node.body, node.orelse))
                return builder.select(test, yes, no)
            case ast.Compare(ops=[operator]) if type(operator) in _COMPARISONS:
                one, other = self._value(node.left, values), self._value(node.comparators[0], values)
                # NaN is not equal to anything, and in no order with it.
                write = builder.fcmp_unordered if isinstance(operator, ast.NotEq) else builder.fcmp_ordered
                return write(_COMPARISONS[type(operator)], one, other)
            case ast.BoolOp():
                write = builder.and_ if isinstance(node.op, ast.And) else builder.or_
                tests = [self._value(part, values) for part in node.values]
                return _joined(write, tests)
            case ast.Call():
                return self._call(node, [self._value(argument, values) for argument in node.args])
        raise _unknown(node)

    def _call(self, node: ast.Call, arguments: list[Any]) -> Any:
        builder = self._builder
        match node.func:
            case ast.Name(id=("min" | "max") as name):
                sign = "<" if name == "min" else ">"
                return _joined(lambda a, b: builder.select(builder.fcmp_ordered(sign, b, a), b, a), arguments)
            case ast.Name(id="abs"):
                return self._function("fabs", arguments)
            case ast.Name(id=name) if name in self._functions:
                names = [argument.arg for argument in self._functions[name].args.args]
                return self.body(self._functions[name], dict(zip(names, arguments, strict=True)))
            case ast.Attribute(attr="sign"):
                zero, one = ir.Constant(_DOUBLE, 0.0), ir.Constant(_DOUBLE, 1.0)
                positive = builder.select(builder.fcmp_ordered(">", arguments[0], zero), one, zero)
                negative = builder.select(builder.fcmp_ordered("<", arguments[0], zero), one, zero)
                return builder.fsub(positive, negative)
            case ast.Attribute(value=ast.Name(id="np"), attr="zeros"):
                return ir.Constant(ir.VectorType(_DOUBLE, node.args[0].value), None)  # type: ignore[attr-defined]
            case ast.Attribute(value=ast.Name(id="math"), attr=name):
                return self._function(name, arguments)
        raise _unknown(node)

    @staticmethod
    def _is_row(target: ast.Subscript, values: dict[str, Any]) -> bool:
        return isinstance(getattr(values[target.value.id], "type", None), ir.VectorType)  # type: ignore[attr-defined]

    def _alike(self, left: Any, right: Any) -> tuple[Any, Any]:
        """Two values of one type: a number beside a row becomes a row of it."""
        if left.type == right.type:
            return left, right
        of = left.type if isinstance(left.type, ir.VectorType) else right.type
        return self._spread(left, of), self._spread(right, of)

    def _spread(self, value: Any, of: Any) -> Any:
        if value.type == of:
            return value
        first = ir.Constant(ir.IntType(32), 0)
        one = self._builder.insert_element(ir.Constant(of, ir.Undefined), value, first)
        same = ir.Constant(ir.VectorType(ir.IntType(32), of.count), None)
        return self._builder.shuffle_vector(one, ir.Constant(of, ir.Undefined), same)

    def _function(self, name: str, arguments: list[Any]) -> Any:
        of_it = ir.FunctionType(_DOUBLE, [_DOUBLE] * len(arguments))
        if name in _INTRINSICS:
            function = self._module.declare_intrinsic(_INTRINSICS[name], [_DOUBLE], of_it)
        else:
            function = self._module.globals.get(name) or ir.Function(self._module, of_it, name)
        return self._builder.call(function, arguments)

    def _power(self, base: Any, exponent: ast.expr, values: dict[str, Any]) -> Any:
        whole = _whole(exponent)
        if whole is None or abs(whole) > 64:
            return self._function("pow", [base, self._value(exponent, values)])
        builder, result, square = self._builder, None, base
        for bit in reversed(f"{abs(whole):b}"):
            if bit == "1":
                result = square if result is None else builder.fmul(result, square, flags=self._flags)
            square = builder.fmul(square, square, flags=self._flags)
        one = ir.Constant(_DOUBLE, 1.0)
        if result is None:
            return one
        return result if whole > 0 else builder.fdiv(one, result, flags=self._flags)

    def _place(self, node: ast.Subscript, values: dict[str, Any]) -> Any:
        array = values[node.value.id]  # type: ignore[attr-defined]
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        at, *further = [self._index(part, values) for part in parts]
        for index, length in zip(further, array.shape[1:], strict=True):
            at = self._builder.add(self._builder.mul(at, length), index)
        return self._builder.gep(array.data, [at], inbounds=True)

    def _index(self, node: ast.expr, values: dict[str, Any]) -> Any:
        if isinstance(node, ast.Constant):
            return ir.Constant(_INTEGER, node.value)
        return self._value(node, values)

    def _load(self, array: _Array, k: int) -> Any:
        return self._builder.load(self._builder.gep(array.data, [ir.Constant(_INTEGER, k)], inbounds=True))


def _joined(write: Callable[[Any, Any], Any], values: list[Any]) -> Any:
    result, *rest = values
    for value in rest:
        result = write(result, value)
    return result


def _whole(node: ast.expr) -> int | None:
    """The integer that an exponent is, if it is one."""
    match node:
        case ast.Constant(value=int(value)):
            return value
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(value))):
            return -value
    return None


@cache
def _announce(name: str) -> None:
    """Tell LLVM where a function of C's math library is, for code just made and code from the cache alike."""
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    try:
        function = getattr(library, name)
    except AttributeError:
        raise ModelError(f"an effect uses {name}(), which C's math library has not") from None
    llvm.add_symbol(name, ctypes.cast(function, ctypes.c_void_p).value)


def _unknown(node: ast.AST) -> ModelError:
    return ModelError(f"an effect's equation holds {ast.unparse(node)!r}, which cannot be compiled")
