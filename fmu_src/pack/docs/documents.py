"""What an FMU holds beside description, binaries and resources: documents, icon, reference.

| file | what |
| --- | --- |
| `documentation/index.html` | entry page, see `page` |
| `documentation/fmi-ls-ref.txt` | how to compare with the reference results |
| `documentation/licenses/` | `license.txt` is the entry; a file for each other's work inside |
| `documentation/externalDependencies.txt` | what the python flavour needs on the target |
| `model.png` | icon |
| `extra/org.fmi-standard.fmi-ls-ref/` | reference results, see `reference` |
| `sources/buildDescription.xml` | how to compile; takes precedence over the description's list |
"""

import importlib.metadata
from pathlib import Path

from lxml import etree

from fmu_src import __version__
from fmu_src.errors import SteadytipError
from fmu_src.kit.model import Model
from fmu_src.pack.codegen import c_source as csource
from fmu_src.pack.docs import icon, page
from fmu_src.pack.fmu import reference
from fmu_src.pack.fmu.description import COPYRIGHT, LICENSE, to_xml

_LICENSES = "documentation/licenses"
_PACKED = "pythonfmu"
"""Whose binaries and modules are in an FMU of the python flavour."""
_NEEDED = ("numpy", "casadi")
"""What the python flavour's slave imports from the target's Python."""


def files(model: Model, flavour: str) -> dict[str, bytes]:
    """Return every one of these files, by its path in the FMU.

    Args:
        model: what is packed.
        flavour: `native` or `python`.

    Raises:
        SteadytipError: the licence text of a package that is packed is not installed with it.
    """
    found = {
        "documentation/index.html": page.html(model, flavour).encode(),
        "documentation/fmi-ls-ref.txt": _comparison(model).encode(),
        f"{_LICENSES}/license.txt": _licence(model, flavour).encode(),
        "model.png": icon.png(),
        **reference.files(model),
    }
    if flavour == "python":
        found[f"{_LICENSES}/{_PACKED}.txt"] = _text_of(_PACKED).encode()
        found["documentation/externalDependencies.txt"] = _dependencies().encode()
    else:
        entry = csource.ENTRY
        found["sources/buildDescription.xml"] = build_description(model.name, entry)
    return found


def build_description(identifier: str, entry: str) -> bytes:
    """Write `sources/buildDescription.xml`, in the format of FMI 3.0, taken over by FMI 2.0.4.

    Args:
        identifier: model identifier.
        entry: the one file to compile; it includes the others.
    """
    root = etree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = etree.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    sources = etree.SubElement(configuration, "SourceFileSet", language="C99")
    etree.SubElement(sources, "SourceFile", name=entry)
    return to_xml(root)


def _licence(model: Model, flavour: str) -> str:
    others = (
        f"It contains PythonFMU, under the licence in {_PACKED}.txt beside this file.\n"
        if flavour == "python"
        else ""
    )
    return (
        f"{model.name} is part of Steadytip {__version__}.\n{COPYRIGHT}\n"
        f"Licensed under the Apache License, Version 2.0 ({LICENSE}), the text of which follows.\n"
        f"{others}\n{_text_of('steadytip')}"
    )


def _text_of(distribution: str) -> str:
    """Return the licence text that an installed package brings with it."""
    try:
        installed = importlib.metadata.files(distribution) or []
    except importlib.metadata.PackageNotFoundError:
        installed = []
    for file in installed:
        if file.parts[0].endswith(".dist-info") and file.name.startswith("LICENSE"):
            return Path(str(file.locate())).read_text(encoding="utf-8")
    raise SteadytipError(
        f"no licence text is installed with {distribution}, and the FMU must hold it;"
        f" reinstall it: pip install --force-reinstall {distribution}"
    )


def _dependencies() -> str:
    versions = "\n".join(f"- {name} {importlib.metadata.version(name)}" for name in _NEEDED)
    return (
        "This FMU runs a Python script. The importing process must find, on its library path and\n"
        "its module path, Python 3.11 or later for the same architecture, and there, in this\n"
        f"version or a later one:\n{versions}\n"
        "The native flavour of the same model needs none of them.\n"
    )


def _comparison(model: Model) -> str:
    stem = f"{reference.FOLDER}/{model.name}"
    inputs = (
        f"{stem}_in.csv\n    Inputs. Each row holds until the next one; do not interpolate.\n"
        if model.variables["input"]
        else ""
    )
    return (
        f"Reference results of {model.name}\n\n"
        f"{inputs}"
        f"{stem}_ref.csv\n"
        "    Outputs at the communication points; row 0 is what initialisation mode shows.\n"
        f"{stem}_ref.opt\n"
        "    Start, stop, communication step (one sample) and relative tolerance.\n\n"
        "All parameters keep their start values. The reference was computed in Python from the\n"
        "same recorded equations, but not by the code inside this FMU. An output agrees when it\n"
        f"is nowhere further off than {reference.TOLERANCE:g} of its largest value in the table.\n"
    )
