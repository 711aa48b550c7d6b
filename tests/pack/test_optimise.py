"""What is taken out of CasADi's C, and what is left."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from fmu_src.errors import SteadytipError
from fmu_src.pack import compiler
from fmu_src.pack.codegen.optimise import optimise

HEAD = "(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem)"


def _function(name: str, *lines: str) -> str:
    return f"static int {name}{HEAD} {{\n" + "".join(f"  {line}\n" for line in lines) + "}\n"


def _matrices(*uses: str) -> str:
    return _function(
        "by_matrices",
        "casadi_real **res1=res+1, *w0=w+12, *w01=w+123;",
        "/* #0: call */",
        "res1[0]=w0;",
        "if (casadi_f1(arg1, res1, iw, w, 0)) return 1;",
        *uses,
        "if (res[0]) casadi_copy(w0, 40, res[0]+7);",
        "return 0;",
    )


def test_a_result_that_is_only_put_out_is_written_where_it_goes():
    text = optimise(_matrices())
    assert "*w0=res[0] ? res[0]+7 : w+12, *w01=w+123;" in text
    assert "casadi_copy" not in text


def test_a_result_that_is_used_stays_in_the_work_vector():
    text = optimise(_matrices("w01[0] = w0[3];"))
    assert "*w0=w+12, *w01=w+123;" in text
    assert "casadi_copy(w0, 40, res[0]+7);" in text


def test_functions_by_elements_take_their_vectors_apart():
    text = optimise(
        _function(
            "by_elements",
            "casadi_real a0;",
            "a0=arg[2]? arg[2][5] : 0;",
            "if (res[0]!=0) res[0][1]=a0;",
            "return 0;",
        )
    )
    inner, outer = text.split("static int by_elements(")
    assert "const casadi_real* restrict u2, casadi_real* restrict y0)" in inner
    assert "a0=u2[5];" in inner
    assert "if (y0!=0) y0[1]=a0;" in inner
    assert "return by_elements_apart(arg, res, iw, w, mem, arg[2], res[0]);" in outer


def test_a_product_of_matrices_has_the_bits_of_casadi(tmp_path, monkeypatch):
    monkeypatch.setattr(compiler, "FOLDER", compiler.FOLDER.resolve())
    monkeypatch.chdir(tmp_path)
    sizes = (13, 7), (7, 11), (11, 3)
    a, b, c = symbols = [ca.MX.sym(f"m{i}", *size) for i, size in enumerate(sizes)]
    product = ca.Function("product", symbols, [a @ b @ c])
    product.generate("product.c")
    text = optimise(Path("product.c").read_text(encoding="utf-8"))
    assert "casadi_rows" in text
    text = '#define CASADI_SYMBOL_EXPORT __attribute__((visibility("default")))\n' + text
    library = compiler.compile_library("product", {"fmu.c": text})
    rng = np.random.default_rng(1)
    values = [rng.normal(size=size) for size in sizes]
    found = ca.external("product", str(library))(*values)
    np.testing.assert_array_equal(found, product(*values))


ELEMENT = ("casadi_real a0;", "a0=arg[2]? arg[2][5] : 0;", "if (res[0]!=0) res[0][1]=a0;")
KNOWN = (
    _function("by_elements", *ELEMENT),
    _matrices(),
    "casadi_real casadi_fmin(casadi_real x, casadi_real y) {\n  return fmin(x, y);\n}\n",
    "void casadi_copy(const casadi_real* x, casadi_int n, casadi_real* y) {\n"
    "  for (i=0; i<n; ++i) *y++ = *x++;\n}\n",
)


@pytest.mark.parametrize(
    ("known", "other"),
    [
        ("static int", "static inline int"),
        ("arg[2]? arg[2][5] : 0", "arg[2] ? arg[2][5] : 0."),
        ("if (res[0]!=0) res[0][1]=a0", "if (res[0]) res[0][1]=a0"),
        ("casadi_copy(w0, 40, res[0]+7)", "casadi_copy(w0, 40, res[0] + 7)"),
        ("return fmin(x, y);", "return isnan(x) ? y : fmin(x, y);"),
        ("*y++ = *x++;", "y[i] = x[i];"),
    ],
)
def test_another_form_of_casadis_text_ends_the_build(known, other):
    """Left as it is, it would be slow, and nobody would know."""
    text = "".join(KNOWN)
    assert known in text
    optimise(text)
    with pytest.raises(SteadytipError, match="in a form that the optimiser"):
        optimise(text.replace(known, other))


def test_another_form_of_a_product_of_matrices_ends_the_build():
    a, b = ca.MX.sym("a", 3, 3), ca.MX.sym("b", 3, 3)
    generator = ca.CodeGenerator("product.c", {"with_header": False})
    generator.add(ca.Function("product", [a, b], [a @ b]))
    text = generator.dump()
    optimise(text)
    with pytest.raises(SteadytipError, match="casadi_mtimes_dense"):
        optimise(text.replace("j<nrow_x", "j < nrow_x"))
