"""C of a container: its members' functions called in order, their values in place.

A member's variables lie together in each vector of the container, so that its functions work on
them where they are; only inputs are gathered.
"""

from collections.abc import Iterator, Mapping

from fmu_src.kit.container import Container, Member, Slices, Source

_HEAD = (
    "static int {name}(const casadi_real** arg, casadi_real** res, int* iw, casadi_real* w,"
    " int mem) {{"
)


def sizes(model: Container, work: Mapping[str, int]) -> dict[str, int]:
    """Return the sizes of the arrays that the container's own functions need.

    Args:
        model: the container.
        work: sizes that its members' functions need.
    """
    inputs = max(len(sources) for sources in model.sources)
    states = max(member.model.state.size() for member in model.members)
    return {**work, "SZ_W": work["SZ_W"] + inputs + states}


def wiring(model: Container, work: Mapping[str, int]) -> str:
    """Write the functions `step`, `derive` and, where it differs from a step, `start`.

    Args:
        model: the container.
        work: sizes of the arrays that its members' functions need.
    """
    starts = [_stepping(model, work, starting=True)] if model.starts_apart else []
    return "\n".join([_stepping(model, work, starting=False), *starts, _deriving(model, work)])


def _stepping(model: Container, work: Mapping[str, int], starting: bool) -> str:
    inputs = max(len(sources) for sources in model.sources)
    name = f"{model.name}_{'start' if starting else 'step'}"
    lines = [
        _HEAD.format(name=name),
        "  const casadi_real *p = arg[0], *d = arg[1], *u = arg[2], *x = arg[3], *r = arg[4];",
        "  casadi_real *following = res[0], *y = res[1];",
        f"  casadi_real *in = w + {work['SZ_W']}, *between = in + {inputs};",
        f"  const casadi_real *a[{work['SZ_ARG']}];",
        f"  casadi_real *o[{work['SZ_RES']}];",
        "  (void)p; (void)d; (void)u; (void)x; (void)r; (void)in; (void)between;",
    ]
    for member, at, sources in zip(model.members, model.slices, model.sources, strict=True):
        lines += [f"  /* {member.name} */", *_gathered(sources, starting)]
        lines += _called(member, at, 1 if starting else model.rate(member))
    for place, first, ticks in model.lines.values():
        lines += [f"  following[{first + i}] = x[{first + i - 1}];" for i in range(1, ticks)]
        lines.append(f"  following[{first}] = y[{place}];")
    return "\n".join([*lines, "  return 0;", "}", ""])


def _gathered(sources: list[Source], starting: bool) -> Iterator[str]:
    for place, source in enumerate(sources):
        value = f"{source.record}[{source.place}]"
        if starting and source.record == "x":
            value = repr(source.start)
        yield f"  in[{place}] = {value};"


def _called(member: Member, at: Slices, samples: int) -> Iterator[str]:
    """Write a member's samples of a tick; its state alternates between two places."""
    end, before = f"following + {at.x.start}", "between"
    yield f"  a[0] = p + {at.p.start}; a[1] = d + {at.d.start}; a[2] = in;"
    yield f"  o[1] = y + {at.y.start};"
    state = f"x + {at.x.start}"
    for sample in range(samples):
        to = end if (samples - 1 - sample) % 2 == 0 else before
        draws = at.r.start + sample * member.model.draws
        yield f"  a[3] = {state}; a[4] = r + {draws}; o[0] = {to};"
        yield f"  if ({member.model.name}_step(a, o, iw, w, mem)) return 1;"
        state = to


def _deriving(model: Container, work: Mapping[str, int]) -> str:
    lines = [
        _HEAD.format(name=f"{model.name}_derive"),
        f"  const casadi_real *a[{work['SZ_ARG']}];",
        f"  casadi_real *o[{work['SZ_RES']}];",
    ]
    for member, at in zip(model.members, model.slices, strict=True):
        lines.append(f"  a[0] = arg[0] + {at.p.start}; o[0] = res[0] + {at.d.start};")
        lines.append(f"  if ({member.model.name}_derive(a, o, iw, w, mem)) return 1;")
    return "\n".join([*lines, "  return 0;", "}", ""])
