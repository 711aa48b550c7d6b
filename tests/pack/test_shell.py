"""What the C shell does that no model shows by itself."""

import numpy as np
import pytest

from fmu_src.kit.noise import uniforms
from fmu_src.pack.codegen.c_source import shell
from fmu_src.pack.compiler import compile_c, host_target

# A host that prints the first words of the shell's generator and some numbers as it writes them.
_PROBE = """
#include <stdio.h>
int main(void) {
    static Instance c;
    uint64_t word[4], i;
    int j;
    double v[] = {0, 1, -1, 0.5, 1e-3, 123456789, 1e9, 1.5e-7, 1e300, -2.5e-300, 0.1, 99999.99995};
    for (i = 1; i <= 3; i++) {
        philox(i, 42, word);
        for (j = 0; j < 4; j++) printf("%.17g\\n", ((double)(word[j] >> 11) + 0.5) * 0x1p-53);
    }
    for (i = 0; i < sizeof v / sizeof *v; i++) {
        c.length = 0;
        say_number(&c, v[i]);
        printf("%.9g %s\\n", v[i], c.text);
    }
    return 0;
}
"""
_MODEL = """
#include <float.h>
#include <math.h>
typedef double Real;
#define MODEL_GUID "{0}"
#define MODEL_PERIOD 1
#define N_P 0
#define N_D 0
#define N_U 0
#define N_Y 0
#define N_X 0
#define N_R 0
#define N_STREAMS 0
#define N_SPANS 0
#define N_LATCHES 0
#define SZ_ARG 6
#define SZ_RES 2
#define SZ_IW 0
#define SZ_W 0
#define MODEL_STEP(a, r, i, w, m) (void)(a), (void)(r)
#define MODEL_START(a, r, i, w, m) (void)(a), (void)(r)
#define MODEL_DERIVE(a, r, i, w, m) (void)(a), (void)(r)
#define MODEL_SLOPE(a, r, i, w, m) (void)(a), (void)(r)
typedef enum { REAL, INTEGER, BOOLEAN, STRING } Type;
typedef struct {
    const char *name, *unit;
    Type type;
    int tunable;
    double start, min, max;
    const char *warning;
} Variable;
static const Variable VARIABLE[1] = {{"", "", STRING, 0, 0, 0, 0, ""}};
static const int STREAM[1][2] = {{0, 0}}, LATCH[1][2] = {{0, 0}};
static const double LOW[1] = {0}, HIGH[1] = {0};
static const struct { int from, to, loose; } SPAN[1] = {{0, 0, 0}};
"""


@pytest.fixture(scope="module")
def printed() -> list[str]:
    import subprocess

    arguments = ["-target", host_target().triple, "-w", "probe.c", "-lm", "-o", "probe"]
    program = compile_c({"model.h": _MODEL, "probe.c": shell() + _PROBE}, arguments, "probe")
    done = subprocess.run([program], capture_output=True, text=True, check=True)
    return done.stdout.split("\n")[:-1]


def test_generator_is_numpys_philox(printed) -> None:
    np.testing.assert_array_equal([float(t) for t in printed[:12]], uniforms(42, 0, 12, 1).ravel())


def test_numbers_in_messages_have_nine_right_digits(printed) -> None:
    for line in printed[12:]:
        expected, written = line.split(" ")
        assert float(written) == pytest.approx(float(expected), rel=2e-9)
        assert len(written) <= 16


@pytest.mark.parametrize("flavour", ["native", "python"])
@pytest.mark.parametrize("isolate", [False, True])
def test_conditions_of_the_parameters_are_warnings_when_they_are_false(
    flavour, isolate, tmp_path
) -> None:
    """A run goes on, says so, and keeps it in its record; good parameters say nothing."""
    import steadytip as st

    scenario = tmp_path / "one.toml"
    scenario.write_text(
        'seconds = 0.05\nstep_size = 1e-3\n[part.inverse]\nfmu = "InversePrandtlIshlinskii"\n'
        f'flavour = "{flavour}"\nisolate = {str(isolate).lower()}\n'
    )
    for thresholds, expected in (({}, []), ({"part.inverse.hysteresis.thresholds[4]": 8.0}, [1])):
        said = []
        result = st.run(
            scenario, overrides=thresholds, out=tmp_path / "out", report=False, status=said.append
        )
        warned = [text for text in said if "warns" in text]
        assert [1 for _ in warned] == expected
        for text in warned:
            assert text.startswith("part 'inverse' warns: ")
            assert "inverse.defined is false: the operator has no inverse" in text
            assert text in result.metadata.notes
