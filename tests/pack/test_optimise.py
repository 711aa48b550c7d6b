"""What is taken out of CasADi's C, and what is left."""

from pathlib import Path

import casadi as ca
import numpy as np

from fmu_src.pack import compiled_runner as compiled
from fmu_src.pack.codegen import c_source as csource
from fmu_src.pack.codegen.optimise import lean
from fmu_src.pack.fmu import native

CACHE = compiled.CACHE.resolve()

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
    text = lean(_matrices())
    assert "*w0=res[0] ? res[0]+7 : w+12, *w01=w+123;" in text
    assert "casadi_copy" not in text


def test_a_result_that_is_used_stays_in_the_work_vector():
    text = lean(_matrices("w01[0] = w0[3];"))
    assert "*w0=w+12, *w01=w+123;" in text
    assert "casadi_copy(w0, 40, res[0]+7);" in text


def test_functions_by_elements_take_their_vectors_apart():
    text = lean(
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
    monkeypatch.chdir(tmp_path)
    sizes = (13, 7), (7, 11), (11, 3)
    a, b, c = symbols = [ca.MX.sym(f"m{i}", *size) for i, size in enumerate(sizes)]
    product = ca.Function("product", symbols, [a @ b @ c])
    product.generate("product.c")
    text = lean(Path("product.c").read_text(encoding="utf-8"))
    assert "casadi_rows" in text
    part = native.TARGETS[native.host()][0]
    text = '#define CASADI_SYMBOL_EXPORT __attribute__((visibility("default")))\n' + text
    library = Path(f"product{part.suffix}").resolve()
    library.write_bytes(native.compile_library("product", {csource.ENTRY: text}, part, CACHE))
    rng = np.random.default_rng(1)
    values = [rng.normal(size=size) for size in sizes]
    found = ca.external("product", str(library))(*values)
    np.testing.assert_array_equal(found, product(*values))
