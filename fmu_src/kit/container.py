"""A container: several models and their wiring as one model.

Within a tick the members run in the order given. Each takes from a link the output of this tick, or
of `delay` ticks ago, and from an input of the container what nothing inside drives; a member whose
sample period is a fraction of the tick runs so many samples, inputs held. Before the first tick a
delayed link holds what its source gives after initialisation; during initialisation its target has
its own start value.

| what | name in the container |
| --- | --- |
| parameter, calculated parameter | `member.name` |
| input, output | `member_name` |
| state, in messages only | `state.member.name`, `state.wires.member_name[i]`, i ticks ago |

An output of a member keeps to the limits of the inputs that it drives, too.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca

from fmu_src.errors import SteadytipError
from fmu_src.kit.model import Model
from fmu_src.kit.records import (
    Derived,
    Field,
    Inputs,
    Outputs,
    Parameters,
    Record,
    Scalar,
    State,
    real,
)

WIRES = "wires"
"""Part of the state that holds what links delay."""
_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_NEARLY = 1e-9


@dataclass(frozen=True, eq=False)
class Member:
    """A model in a container.

    Attributes:
        name: under which its variables are known, a C identifier.
        model: what it is.
        starts: values of parameters other than the model's starts, by their scalar names.
    """

    name: str
    model: Model
    starts: Mapping[str, float]


@dataclass(frozen=True)
class MemberLink:
    """From an output of a member to an input of another, each `(member, scalar)`.

    Attributes:
        source: output.
        target: input.
        delay: ticks by which the value arrives later.
    """

    source: tuple[str, str]
    target: tuple[str, str]
    delay: int = 0


@dataclass(frozen=True)
class Source:
    """Source of the value of a member's input.

    Attributes:
        record: `u`, an input of the container; `y`, an output of this tick; `x`, one of an earlier.
        place: in that vector.
        start: the input's own start value.
    """

    record: str
    place: int
    start: float


@dataclass(frozen=True)
class Slices:
    """Places of a member's variables in the container's vectors."""

    p: slice
    d: slice
    x: slice
    y: slice
    r: slice


@dataclass(frozen=True, eq=False)
class Container(Model):
    """Members and links as a model; made by `contain`."""

    members: tuple[Member, ...] = ()
    links: tuple[MemberLink, ...] = ()

    @property
    def documentation(self) -> str:
        """Text on the parts inside and the wires between them."""
        inside = [f"| `{m.name}` | {m.model.name} | {m.model.summary} |" for m in self.members]
        wires = [
            f"| `{'.'.join(link.source)}` | `{'.'.join(link.target)}` | {link.delay or ''} |"
            for link in self.links
        ]
        return "\n".join(
            [
                f"{', '.join(member.name for member in self.members)} as one FMU",
                "",
                "Within a tick the members run in this order:",
                "",
                "| member | model | |",
                "| --- | --- | --- |",
                *inside,
                "",
                "Their wires, with the delay in ticks where there is one; every other input is an",
                "input of this FMU:",
                "",
                "| from | to | delay |",
                "| --- | --- | --- |",
                *wires,
            ]
        )

    @property
    def noise_streams(self) -> list[tuple[int, int]]:
        """See `Model.noise_streams`; a member's stream is that of its own seed."""
        return [
            (at.p.start + seed, count * self.rate(member))
            for member, at in zip(self.members, self.slices, strict=True)
            for seed, count in member.model.noise_streams
        ]

    def rate(self, member: Member) -> int:
        """Return the samples of a member in a tick."""
        return round(self.sample_period / member.model.sample_period)

    @property
    def starts_apart(self) -> bool:
        """True if initialisation is anything else than a tick: several samples, or delays."""
        delayed = any(link.delay for link in self.links)
        return delayed or any(self.rate(member) > 1 for member in self.members)

    @property
    def initial_latches(self) -> list[tuple[int, int]]:
        """See `Model.initial_latches`: what is delayed is, at first, what initialisation shows."""
        return [
            (place, first + tick)
            for place, first, ticks in self.lines.values()
            for tick in range(ticks)
        ]

    @cached_property
    def slices(self) -> list[Slices]:
        """Slices of each member."""
        found = []
        p = d = x = y = r = 0
        for member in self.members:
            model = member.model
            at = Slices(
                p=slice(p, p + model.parameters.size()),
                d=slice(d, d + model.derived.size()),
                x=slice(x, x + model.state.size()),
                y=slice(y, y + model.outputs.size()),
                r=slice(r, r + model.draws * self.rate(member)),
            )
            found.append(at)
            p, d, x, y, r = at.p.stop, at.d.stop, at.x.stop, at.y.stop, at.r.stop
        return found

    @cached_property
    def lines(self) -> dict[tuple[str, str], tuple[int, int, int]]:
        """Place in y, first place in x, and ticks, of each delayed output."""
        outputs = self._output_places()
        found = {}
        at = self.slices[-1].x.stop
        for source, ticks in _delayed(self.links).items():
            found[source] = (outputs[source], at, ticks)
            at += ticks
        return found

    def _output_places(self) -> dict[tuple[str, str], int]:
        names = (
            (member.name, scalar.name)
            for member in self.members
            for scalar in member.model.outputs.scalars()
        )
        return {name: place for place, name in enumerate(names)}

    @cached_property
    def sources(self) -> list[list[Source]]:
        """Sources of every input of each member, in its order."""
        outputs = self._output_places()
        links = {link.target: link for link in self.links}
        places = {scalar.name: place for place, scalar in enumerate(self.inputs.scalars())}
        found = []
        for member in self.members:
            taken = []
            for scalar in member.model.inputs.scalars():
                link = links.get((member.name, scalar.name))
                if link is None:
                    source = Source("u", places[f"{member.name}_{scalar.name}"], scalar.start)
                elif link.delay:
                    _, first, _ = self.lines[link.source]
                    source = Source("x", first + link.delay - 1, scalar.start)
                else:
                    source = Source("y", outputs[link.source], scalar.start)
                taken.append(source)
            found.append(taken)
        return found

    @cached_property
    def step_function(self) -> ca.Function:
        """A tick; see `Model.step_function`."""
        return self._recorded("step", self.rate, starting=False)

    @cached_property
    def start_function(self) -> ca.Function:
        """Function of initialisation: the first sample of every member, nothing delayed yet."""
        return self._recorded("start", lambda member: 1, starting=True)

    def _recorded(self, name: str, rate: Callable[[Member], int], starting: bool) -> ca.Function:
        p, d, u, x, r = self.step_symbols()
        y: list[Any] = []
        following: list[Any] = []
        vectors: dict[str, Any] = {"u": u, "x": x, "y": y}
        for member, at, sources in zip(self.members, self.slices, self.sources, strict=True):
            values = [
                s.start if starting and s.record == "x" else vectors[s.record][s.place]
                for s in sources
            ]
            u_member = ca.vertcat(*values) if values else ca.MX(0, 1)
            moved, out = x[at.x], ca.MX(0, 1)
            count = member.model.draws
            for sample in range(rate(member)):
                first = at.r.start + sample * count
                draws = r[first : first + count]
                step = member.model.step_function
                moved, out = step(p[at.p], d[at.d], u_member, moved, draws)
            following.append(moved)
            y += ca.vertsplit(out) if out.shape[0] else []
        for place, first, ticks in self.lines.values():
            following += [y[place], x[first : first + ticks - 1]]
        columns = [ca.densify(ca.vertcat(*part)) for part in (following, y)]
        names = [*"pdux", "r"]
        return ca.Function(name, [p, d, u, x, r], columns, names, ["x_next", "y"])

    @cached_property
    def derive_function(self) -> ca.Function:
        """See `Model.derive_function`."""
        p = ca.MX.sym("p", self.parameters.size())
        derived = [
            member.model.derive_function(p[at.p])
            for member, at in zip(self.members, self.slices, strict=True)
        ]
        column = ca.densify(ca.vertcat(*derived)) if self.derived.size() else ca.MX(0, 1)
        return ca.Function("derive", [p], [column], ["p"], ["d"])


def contain(
    name: str, members: Sequence[Member], links: Sequence[MemberLink], sample_period: float
) -> Container:
    """Put models into a container.

    Args:
        name: of the container, a C identifier.
        members: in run order.
        links: between them.
        sample_period: the tick [s].

    Raises:
        SteadytipError: a name that is no C identifier, two variables of one name, a sample period
            that is no fraction of the tick, a link from a member that has not run yet.
    """
    _check(name, members, links, sample_period)
    driven = {link.target for link in links}
    outputs = {
        (member.name, scalar.name): _narrowed(member, scalar, members, links)
        for member in members
        for scalar in member.model.outputs.scalars()
    }
    free = {
        member.name: {
            scalar.name: replace(scalar.field, shape=(), axes=None, start=(scalar.start,))
            for scalar in member.model.inputs.scalars()
            if (member.name, scalar.name) not in driven
        }
        for member in members
    }
    lines = {
        "_".join(source): real(
            outputs[source].unit,
            f"{'.'.join(source)}, i ticks ago",
            shape=ticks,
            listed=False,
        )
        for source, ticks in _delayed(links).items()
    }
    states = {member.name: _unlisted(member.model.state) for member in members}
    found = Container(
        name,
        _no_step,
        _record(Parameters, {m.name: _restarted(m.model.parameters, m.starts) for m in members}),
        _record(Inputs, {n: _record(Inputs, fields) for n, fields in free.items() if fields}),
        _record(State, {**states, **({WIRES: _record(State, lines)} if lines else {})}),
        _record(
            Outputs,
            {
                m.name: _record(
                    Outputs, {s.name: outputs[m.name, s.name] for s in m.model.outputs.scalars()}
                )
                for m in members
            },
        ),
        sample_period,
        derived=_record(Derived, {m.name: m.model.derived for m in members}),
        draws=sum(m.model.draws * round(sample_period / m.model.sample_period) for m in members),
        matrix=True,
        derivatives=False,
        members=tuple(members),
        links=tuple(links),
    )
    for record in (found.inputs, found.outputs):
        names = [scalar.name for scalar in record.scalars()]
        twice = sorted({one for one in names if names.count(one) > 1})
        if twice:
            raise SteadytipError(
                f"container {name}: two variables would be called '{twice[0]}'; rename a part"
            )
    return found


def _delayed(links: Sequence[MemberLink]) -> dict[tuple[str, str], int]:
    """Return outputs that arrive later, with the longest of their delays [ticks]."""
    found: dict[tuple[str, str], int] = {}
    for link in links:
        if link.delay:
            found[link.source] = max(found.get(link.source, 0), link.delay)
    return found


def _no_step(*_arguments: Any) -> Any:
    raise NotImplementedError("a container is recorded from its members' recorded steps")


def _check(
    name: str, members: Sequence[Member], links: Sequence[MemberLink], sample_period: float
) -> None:
    for what in (name, *(member.name for member in members)):
        if not _IDENTIFIER.fullmatch(what) or what == WIRES:
            raise SteadytipError(
                f"container {name}: '{what}' must be a C identifier other than '{WIRES}':"
                " letters, digits and _, a letter first"
            )
    for member in members:
        samples = sample_period / member.model.sample_period
        if abs(samples - round(samples)) > _NEARLY * samples or round(samples) < 1:
            raise SteadytipError(
                f"container {name}: the tick of {sample_period:g} s must be a whole multiple of"
                f" the sample period of '{member.name}' ({member.model.name}),"
                f" {member.model.sample_period:g} s"
            )
    order = [member.name for member in members]
    for link in links:
        source, target = order.index(link.source[0]), order.index(link.target[0])
        if not link.delay and source >= target:
            raise SteadytipError(
                f"container {name}: '{'.'.join(link.target)}' needs '{'.'.join(link.source)}'"
                " of the same tick, which is computed after it"
            )


def _record(base: type[Record], fields: Mapping[str, Any]) -> Any:
    return type(base.__name__, (base,), dict(fields))


def _unlisted(record: type[Record]) -> type[Record]:
    fields = {
        name: replace(field, listed=False) if isinstance(field, Field) else _unlisted(field)
        for name, field in record.fields.items()
    }
    return type(record.__name__, (record,), fields)


def _narrowed(
    member: Member, scalar: Scalar, members: Sequence[Member], links: Sequence[MemberLink]
) -> Field:
    """Limit an output to its own limits and those of the inputs that it drives."""
    fields = [scalar.field]
    models = {other.name: other.model for other in members}
    for link in links:
        if link.source == (member.name, scalar.name):
            target, name = link.target
            fields += [s.field for s in models[target].inputs.scalars() if s.name == name]
    low, high = max(f.min for f in fields), min(f.max for f in fields)
    start = min(max(scalar.start, low), high)
    return replace(scalar.field, shape=(), axes=None, start=(start,), min=low, max=high)


def _restarted(record: type[Record], starts: Mapping[str, float], prefix: str = "") -> type[Record]:
    """Return a record with other start values of single scalars."""
    fields: dict[str, Any] = {}
    for name, field in record.fields.items():
        if not isinstance(field, Field):
            fields[name] = _restarted(field, starts, f"{prefix}{name}.")
            continue
        only = _record(Parameters, {name: field})
        values = [float(starts.get(prefix + s.name, s.start)) for s in only.scalars()]
        fields[name] = replace(field, start=tuple(values))
    return type(record.__name__, (record,), fields)
