"""What a program computes, read off its jaxpr."""

CALLS = {"jit", "pjit", "custom_vjp_call"}


def equations(jaxpr):
    """All equations of a program, those of its inner programs too; calls, which compute nothing, left out."""
    for equation in jaxpr.eqns:
        if equation.primitive.name not in CALLS:
            yield equation
        for value in equation.params.values():
            for item in value if isinstance(value, (tuple, list)) else [value]:
                if hasattr(item, "eqns"):
                    yield from equations(getattr(item, "jaxpr", item))
