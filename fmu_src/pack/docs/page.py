"""Entry page of an FMU's documentation: `documentation/index.html`, one file with all it needs.

Text and equations come from the docstring of the model's module, tables from its records, figures
from the recorded function. Nothing in it depends on the machine or the hour.
"""

import base64
import re
from functools import cache

import jinja2
from markdown_it import MarkdownIt
from markupsafe import Markup

from fmu_src import __version__
from fmu_src.kit.container import Container
from fmu_src.kit.model import Model
from fmu_src.kit.records import Record
from fmu_src.pack.docs import icon, response, variables
from fmu_src.pack.fmu import reference
from fmu_src.pack.fmu.description import COPYRIGHT, LICENSE

PAPERS = {
    "A04": "W. T. Ang, Active Tremor Compensation in Handheld Instrument for Microsurgery, PhD"
    " thesis, Carnegie Mellon University, CMU-RI-TR-04-28, 2004",
    "AKR": "W. T. Ang, P. K. Khosla, C. N. Riviere, Kalman Filtering for Real-Time Orientation"
    " Tracking of Handheld Microsurgical Instrument, Carnegie Mellon University",
    "E13": "N. Enayati, Quaternion-Based Unscented Kalman Filter for Robust Motion Tracking in"
    " Neurosurgery, MSc thesis, Politecnico di Milano, 2013",
    "RK": "H. Ren, P. Kazanzides, Hybrid Attitude Estimation for Laparoscopic Surgical Tools: A"
    " Preliminary Study, Johns Hopkins University",
    "C23": "W.-H. Cheng, Attitude and Angular Velocity Estimation of Surgical Robot Using Sensor"
    " Fusion with Optical Tracker, IMU, and Quaternion-based Extended Kalman Filter, National"
    " Taiwan University, 2023",
}
"""Papers by the short names that docstrings use."""


def html(model: Model, flavour: str) -> str:
    """Write the page.

    Args:
        model: what it is about.
        flavour: `native` or `python`.
    """
    text = model.documentation
    derive_count = model.operations(model.derive_function) if model.derive is not None else ""
    return _TEMPLATE.render(
        model=model,
        flavour=flavour,
        style=Markup(_STYLE),
        text=Markup(_markdown(text.partition("\n")[2])),
        groups=[
            (title, tuple(variables.rows(record, prefix)))
            for title, record, prefix in _groups(model)
        ],
        responses=None if isinstance(model, Container) else _responses(model),
        papers=[(key, name) for key, name in PAPERS.items() if re.search(rf"\b{key}\b", text)],
        milliseconds=f"{model.sample_period * 1e3:g}",
        step_count=model.operations(model.step_function),
        derive_count=derive_count,
        values=sum(map(len, model.variables.values())),
        stimulated=bool(model.variables["input"]),
        source="" if isinstance(model, Container) else variables.source(model),
        reference=reference,
        response=response,
        icon=base64.b64encode(icon.png()).decode(),
        version=__version__,
        copyright=COPYRIGHT,
        license=LICENSE,
    )


def _markdown(text: str) -> str:
    # Raw HTML stays text: comparisons in a docstring are no tags.
    return MarkdownIt("commonmark", {"html": False}).enable("table").render(text)


def _groups(model: Model) -> list[tuple[str, type[Record], str]]:
    """Return the titles, records, and the prefix under which their variables are known."""
    return [
        ("Inputs", model.inputs, ""),
        ("Outputs", model.outputs, ""),
        ("Parameters", model.parameters, ""),
        ("Calculated parameters", model.derived, ""),
        ("State", model.state, "state."),
    ]


@cache
def _responses(model: Model) -> list[response.Response]:
    # Both flavours of a model respond alike, and measuring takes a second or two.
    return response.responses(model)


def _signed(value: float, digits: int) -> str:
    """Format with fixed digits, with a real minus sign, and none before zero."""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", "\N{MINUS SIGN}")


_STYLE = """
:root { color-scheme: light; --ink: #1c2733; --soft: #5b6b7a; --line: #d5dde4; --accent: #145c8c; }
* { box-sizing: border-box; }
body { color: var(--ink); background: #fff; max-width: 62rem; margin: 0 auto; padding: 2rem 1.5rem;
  font: 16px/1.55 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
header { display: flex; gap: 1.2rem; align-items: center; border-bottom: 2px solid var(--accent);
  padding-bottom: 1rem; }
header img { width: 72px; height: 72px; }
h1 { margin: 0; font-size: 1.9rem; line-height: 1.2; overflow-wrap: anywhere; }
header p { margin: .2rem 0 0; color: var(--soft); }
h2 { margin: 2.2rem 0 .6rem; font-size: 1.25rem; color: var(--accent); }
h3 { margin: 1.4rem 0 .4rem; font-size: 1rem; }
code, pre { font: .88em/1.5 ui-monospace, Consolas, "DejaVu Sans Mono", monospace; }
pre { background: #f4f7f9; border-left: 3px solid var(--accent); padding: .8rem 1rem;
  overflow-x: auto; }
table { border-collapse: collapse; width: 100%; margin: .6rem 0 1rem; font-size: .92rem; }
th, td { text-align: left; vertical-align: top; padding: .3rem .6rem .3rem 0;
  border-bottom: 1px solid var(--line); }
th { color: var(--soft); font-weight: 600; }
td.number, th.number { text-align: right; white-space: nowrap; padding-right: 1.2rem; }
td.name, td.unit, td.range { white-space: nowrap; }
td.start { min-width: 7rem; } td.sentence { width: 45%; min-width: 9rem; }
.scroll { overflow-x: auto; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .25rem 1.2rem; margin: 0; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; }
footer { margin-top: 2.5rem; padding-top: .8rem; border-top: 1px solid var(--line);
  color: var(--soft); font-size: .88rem; }
@media print {
  @page { margin: 16mm; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  table { font-size: 8pt; } pre { white-space: pre-wrap; } pre, tr, header { break-inside: avoid; }
  h2, h3 { break-after: avoid; } thead { display: table-header-group; }
}
"""

_PAGE = """\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ model.name }}</title>
<link rel="icon" href="data:image/png;base64,{{ icon }}">
<style>{{ style }}</style>
</head>
<body>
<header>
<img src="data:image/png;base64,{{ icon }}" alt="">
<div><h1>{{ model.name }}</h1><p>{{ model.summary }}</p></div>
</header>
<main>
<h2>At a glance</h2>
<dl>
<dt>Interface</dt><dd>FMI 2.0 for co-simulation, {{ flavour }} flavour, Steadytip {{ version }}</dd>
<dt>Sample period</dt><dd>{{ milliseconds }} ms</dd>
<dt>Cost</dt><dd>{{ step_count }} a sample
{%- if derive_count %}, {{ derive_count }} more when a parameter changes{% endif %}</dd>
<dt>Memory</dt><dd>{{ values }} values, {{ model.state.size() }} of them state</dd>
<dt>Randomness</dt><dd>{% if model.draws %}{{ model.draws }} draws a sample, fixed by
{{ "its" if source else "its members'" }} <code>seed</code>{% else %}none{% endif %}</dd>
{%- if source %}
<dt>Written in</dt><dd><code>{{ source }}</code></dd>
{%- endif %}
</dl>
<p>The time that a sample takes is the machine's: <code>make bench</code> in the source tree
measures it.</p>

<h2>{{ "What it does" if source else "What is inside" }}</h2>
{{ text }}
<h2>Ports and parameters</h2>
<p>SI units throughout. A field with a shape is one row: on ports its elements are
<code>name_x</code> or <code>name_1</code>, elsewhere <code>name[1]</code>. A start that holds for
several elements is written once, with their number.</p>
{%- for title, rows in groups if rows %}
{%- set settable = title in ("Inputs", "Parameters") %}
<h3>{{ title }}</h3>
<div class="scroll"><table>
<thead><tr><th>name</th><th>unit</th>{% if settable %}<th>start</th>{% endif %}<th>range</th>
<th>meaning</th></tr></thead>
<tbody>
{%- for row in rows %}
<tr><td class="name"><code>{{ row.name }}</code>{% if row.shape %} ({{ row.shape }}){% endif %}</td>
<td class="unit">{{ row.unit }}</td>
{%- if settable %}<td class="start">{{ row.start }}</td>{% endif %}
<td class="range">{{ row.limits }}</td><td class="sentence">{{ row.sentence }}</td></tr>
{%- endfor %}
</tbody></table></div>
{%- endfor %}
{%- if responses is not none %}

<h2>Response at {{ "%g" | format(reference.TONE) }} Hz</h2>
{%- if responses %}
<div class="scroll"><table>
<thead><tr><th>input</th><th>output</th><th class="number">gain</th><th></th>
<th class="number">phase [deg]</th><th class="number">group delay [ms]</th></tr></thead>
<tbody>
{%- for r in responses %}
<tr><td><code>{{ r.source }}</code></td><td><code>{{ r.output }}</code></td>
<td class="number">{{ "%.3g" | format(r.gain) }}</td><td>{{ r.unit }}</td>
<td class="number">{{ r.phase | signed(1) }}</td>
<td class="number">{{ (r.group_delay * 1e3) | signed(2) }}</td></tr>
{%- endfor %}
</tbody></table></div>
<p>Measured on the model itself, parameters at their starts and noise off: a tone of the size that
the reference results use moves one input, the others rest, and after
{{ "%g" | format(response.SETTLING) }} s the output is compared with it over
{{ "%g" | format(response.WINDOW) }} s; the group delay is from tones 1 Hz apart. Each output is
shown with the input of its unit and axis, or else with the one that moves it most; outputs that do
not answer with a tone are left out. Phase counts positive where the output leads. These are delays
between equal samples: who sets inputs and reads outputs once a step sees one step more.</p>
{%- else %}
<p>No output answers a tone at one input with a tone: parameters at their starts, inputs at
rest.</p>
{%- endif %}
{%- endif %}

<h2>How it behaves in a simulation</h2>
<ul>
<li>Sample <var>n</var> lies at start time + <var>n</var> T. A step from <var>t</var> over
<var>h</var> runs the samples in [<var>t</var>, <var>t</var> + <var>h</var>) with the inputs set
before it; the outputs afterwards are those of the last one.</li>
<li>In initialisation mode the outputs are those that the first sample would give.</li>
<li>A value that is not finite or outside its range is refused by name, with its bound, and none of
the call's values is set. Outputs are always finite.</li>
<li>Tunable parameters may be set between steps, all others before the first one.</li>
<li>The state can be saved, restored and serialised; a run that is cut and continued gives the same
numbers as the uncut one.</li>
</ul>

<h2>Settings of the importer</h2>
<ul>
<li>Communication step: {{ milliseconds }} ms, or a whole multiple of it. Other steps work, too;
samples then fall inside them.</li>
<li>Fixed step, no interpolation of inputs: they are sampled and held.</li>
<li>In a loop of FMUs, dependencies are those over a step of one sample.</li>
{%- if flavour == "python" %}
<li>What must be installed: <code>documentation/externalDependencies.txt</code>. An importer that
refuses <code>needsExecutionTool</code> takes the native flavour.</li>
{%- else %}
<li>Nothing has to be installed. For other platforms compile <code>sources/fmu.c</code> (C99), which
includes the other files, or build the project with <code>--target all</code>.</li>
{%- endif %}
</ul>

<h2>Checking an import</h2>
<p>The default experiment has reference results in <code>{{ reference.FOLDER }}</code>:
{% if stimulated %}inputs <code>{{ model.name }}_in.csv</code>, {% endif -%}
outputs <code>{{ model.name }}_ref.csv</code>, times and tolerance
<code>{{ model.name }}_ref.opt</code>. <a href="fmi-ls-ref.txt">How to compare</a>.</p>
{%- if papers %}

<h2>Sources</h2>
<dl>
{%- for key, name in papers %}
<dt>{{ key }}</dt><dd>{{ name }}</dd>
{%- endfor %}
</dl>
{%- endif %}
</main>
<footer>{{ copyright }}. {{ license }}: <a href="licenses/license.txt">licences</a>.</footer>
</body>
</html>
"""

_environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
_environment.filters["signed"] = _signed
_TEMPLATE = _environment.from_string(_PAGE)
