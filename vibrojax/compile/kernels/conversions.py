"""Rules for primitives that turn numbers into numbers of another type."""

from vibrojax.compile.kernels.operands import BOOL, Untranslatable
from vibrojax.compile.kernels.rules import ANY, Applied, Rule


def _same_bits(op: Applied) -> str:
    if op.gives == op.dtype:
        return op.x[0]
    if op.gives.itemsize != op.dtype.itemsize or op.gives == BOOL:
        raise Untranslatable(f"the bits of {op.dtype} as {op.gives}")
    return op.asm.let(f"bitcast {op.type} {op.x[0]} to {op.asm.type(op.gives, op.varying)}")


def _converted(op: Applied) -> str:
    if op.gives == op.dtype:
        return op.x[0]
    if op.gives == BOOL:
        return op.compared("une" if op.is_float else "ne", op.x[0], op.constant(0))
    if op.is_float and op.gives.kind != "f":
        return saturated(op)
    wider = op.gives.itemsize > op.dtype.itemsize
    if op.is_float:
        how = "fpext" if wider else "fptrunc"
    elif op.gives.kind == "f":
        how = "sitofp" if op.order == "s" else "uitofp"
    elif wider or op.dtype == BOOL:
        how = "sext" if op.order == "s" else "zext"
    elif op.gives.itemsize < op.dtype.itemsize:
        how = "trunc"
    else:
        return op.x[0]
    return op.asm.let(f"{how} {op.type} {op.x[0]} to {op.asm.type(op.gives, op.varying)}")


def saturated(op: Applied) -> str:
    """Write the conversion of a float to an integer: the nearest one there is, and 0 for NaN."""
    asm, lanes = op.asm, f"v{op.asm.width}" if op.varying else ""
    name = f"llvm.fpto{'s' if op.gives.kind == 'i' else 'u'}i.sat"
    name += f".{lanes}{asm.suffix(op.gives)}.{lanes}{asm.suffix(op.dtype)}"
    return asm.call(name, op.x, asm.type(op.gives, op.varying), takes=op.type)


RULES: dict[str, Rule] = {
    "bitcast_convert_type": Rule(_same_bits, ANY),
    "convert_element_type": Rule(_converted, ANY),
}
