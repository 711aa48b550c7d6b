/* FMI 2.0 co-simulation shell, the same for every model.
 *
 * model.h (generated) declares the variables and sizes; functions.c (generated) holds
 *     <Model>_derive(p) -> d               when parameters change
 *     <Model>_step(p, d, u, x, r) -> x', y at every sample instant
 *     <Model>_start(p, d, u, x, r) -> x', y before the first one, where that is not a step
 *     <Model>_slope(p, d, u, x, r, du) -> dy, where the model gives derivatives
 * in the type Real, which is double, or float with STEADYTIP_FLOAT (then seeds are exact up to 2^24).
 * This file owns everything else: the clock, limits, states, messages.
 *
 * Clock: sample n lies at start + n T. fmi2DoStep(t, h) runs the instants in [t, t + h) with the
 * inputs set before the call; the outputs afterwards are those of the last instant. In
 * initialisation mode the outputs are those that the first instant would give.
 *
 * Memory: nothing is allocated after fmi2Instantiate but the states asked for by fmi2GetFMUstate.
 * There are no globals, so instances do not see each other.
 */
#include <float.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

/* ---- The interface of FMI 2.0, in its default types ----------------------------------------- */

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef char fmi2Byte;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
    fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated
} fmi2StatusKind;

typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

#if defined(FMI2_FUNCTION_PREFIX)
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define FMI2(name) JOIN(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI2(name) name
#endif

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

/* ---- An instance ----------------------------------------------------------------------------- */

/* Value references number the variables through p, d, u, y, x in this order. */
#define AT_D (N_P)
#define AT_U (AT_D + N_D)
#define AT_Y (AT_U + N_U)
#define AT_X (AT_Y + N_Y)
#define N_VALUES (AT_X + N_X)

enum {
    INSTANTIATED = 1, INITIALIZATION = 2, STEPPING = 4, TERMINATED = 8, FAILED = 16,
    /* Combinations that several functions share. */
    READABLE = INITIALIZATION | STEPPING | TERMINATED | FAILED,
    ANY = INSTANTIATED | READABLE
};

/* All that a restored state brings back. */
typedef struct {
    Real value[N_VALUES + 1];
    double start, stop, time;
    uint64_t samples;
    uint32_t mode, has_stop, stale;
} Memory;

typedef struct {
    uint32_t magic;
    Memory memory;
} State;

#define TEXT 512

typedef struct {
    fmi2CallbackFunctions callbacks;
    char *name;
    fmi2Boolean logging;
    Memory now;
    Real y_next[N_Y + N_X + 1], draws[N_R + 1], du[N_U + 1], work[SZ_W + 1];
    int iwork[SZ_IW + 1];
    char text[TEXT];
    size_t length;
    uint32_t said; /* checksum of the last message */
} Instance;

#define STATE_MAGIC 0x53545459u /* "STTY" */
#define LAYOUT_VERSION 1u

/* A run longer than this in one call is refused, so that every call ends. */
#define MOST_SAMPLES 1e6

/* ---- Messages, without stdio ------------------------------------------------------------------ */

static void say(Instance *c, const char *part) {
    while (*part != '\0' && c->length + 1 < TEXT) c->text[c->length++] = *part++;
    c->text[c->length] = '\0';
}

static void say_number(Instance *c, double v) {
    char digit[2] = {0, 0}, block[10];
    int exponent = 0, i, last, shift;
    long scaled;
    if (isnan(v)) { say(c, "nan"); return; }
    if (v < 0) { say(c, "-"); v = -v; }
    if (isinf(v)) { say(c, "inf"); return; }
    if (v == 0) { say(c, "0"); return; }
    exponent = (int)floor(log10(v));
    /* Nine digits; two steps keep the power of ten inside the range of a double. */
    scaled = (long)floor(v / pow(10, exponent / 2) / pow(10, exponent - exponent / 2) * 1e8 + 0.5);
    if (scaled >= 1000000000L) { scaled /= 10; exponent += 1; }
    for (i = 8; i >= 0; i--) { block[i] = (char)('0' + scaled % 10); scaled /= 10; }
    block[9] = '\0';
    for (last = 8; last > 0 && block[last] == '0'; last--) { }
    shift = exponent >= -4 && exponent < 9 ? exponent : 0;
    if (shift < 0) {
        say(c, "0.");
        for (i = -1; i > shift; i--) say(c, "0");
    }
    for (i = 0; i <= last || i <= shift; i++) {
        digit[0] = block[i];
        say(c, digit);
        if (i == shift && i < last) say(c, ".");
    }
    if (shift != exponent) {
        say(c, "e");
        say_number(c, exponent);
    }
}

static void begin(Instance *c, const char *where) {
    c->length = 0;
    say(c, where);
    say(c, ": ");
}

static uint32_t crc32(const fmi2Byte *data, size_t n) {
    uint32_t crc = 0xFFFFFFFFu;
    int bit;
    while (n-- > 0) {
        crc ^= (unsigned char)*data++;
        for (bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

/* Refusals are reported even with logging off, but then each only once in a row. */
static fmi2Status end(Instance *c, fmi2Status status) {
    const char *category = status == fmi2Discard   ? "logStatusDiscard"
                           : status == fmi2Warning ? "logStatusWarning"
                                                   : "logStatusError";
    uint32_t text = crc32(c->text, c->length);
    int again = !c->logging && text == c->said;
    c->said = text;
    if (c->callbacks.logger != NULL && !again) {
        c->callbacks.logger(
            c->callbacks.componentEnvironment, c->name, status, category, "%s", c->text);
    }
    return status;
}

static fmi2Status refuse(Instance *c, const char *where, const char *why) {
    begin(c, where);
    say(c, why);
    return end(c, fmi2Error);
}

/* A step or an initialisation that went wrong: only reading, restoring and resetting remain. */
static fmi2Status fail(Instance *c, fmi2Status status) {
    c->now.mode = FAILED;
    return end(c, status);
}

static void say_bounds(Instance *c, const Variable *v) {
    say(c, " must be ");
    if (v->min > -DBL_MAX && v->max < DBL_MAX) {
        say(c, "in [");
        say_number(c, v->min);
        say(c, ", ");
        say_number(c, v->max);
        say(c, "]");
    } else if (v->min > -DBL_MAX) {
        say(c, "at least ");
        say_number(c, v->min);
    } else if (v->max < DBL_MAX) {
        say(c, "at most ");
        say_number(c, v->max);
    } else {
        say(c, "finite");
    }
    say(c, v->unit);
}

static int within(const Variable *v, Real value) {
#if defined(STEADYTIP_FLOAT)
    if (!isfinite(value)) return 0; /* DBL_MAX is infinite as a float */
#endif
    return value >= (Real)v->min && value <= (Real)v->max; /* limits are finite, at most DBL_MAX */
}

static int legal(Instance *c, const char *where, uint32_t modes) {
    if (c == NULL) return 0;
    if (c->now.mode & modes) return 1;
    begin(c, where);
    say(c, "not allowed ");
    say(c, c->now.mode == INSTANTIATED     ? "before fmi2EnterInitializationMode"
           : c->now.mode == INITIALIZATION ? "in initialisation mode"
           : c->now.mode == STEPPING       ? "between steps"
           : c->now.mode == TERMINATED     ? "after fmi2Terminate"
                                           : "after an error; reset or restore a state first");
    end(c, fmi2Error);
    return 0;
}

/* ---- Noise: Philox4x64-10, counter in the first word, key = (seed, 0), as NumPy's ------------ */

static uint64_t high_product(uint64_t a, uint64_t b) {
    const uint64_t low = 0xFFFFFFFFu;
    uint64_t a0 = a & low, a1 = a >> 32, b0 = b & low, b1 = b >> 32;
    uint64_t middle = a1 * b0 + (a0 * b0 >> 32);
    uint64_t cross = a0 * b1 + (middle & low);
    return a1 * b1 + (middle >> 32) + (cross >> 32);
}

static void philox(uint64_t counter, uint64_t seed, uint64_t word[4]) {
    const uint64_t m0 = 0xD2E7470EE14C6C93u, m1 = 0xCA5A826395121157u;
    uint64_t key0 = seed, key1 = 0, t;
    int round;
    word[0] = counter;
    word[1] = word[2] = word[3] = 0;
    for (round = 0; round < 10; round++) {
        uint64_t h0 = high_product(m0, word[0]), l0 = m0 * word[0];
        uint64_t h1 = high_product(m1, word[2]), l1 = m1 * word[2];
        t = word[1];
        word[0] = h1 ^ t ^ key0;
        word[2] = h0 ^ word[3] ^ key1;
        word[1] = l1;
        word[3] = l0;
        key0 += 0x9E3779B97F4A7C15u;
        key1 += 0xBB67AE8584CAA73Bu;
    }
}

/* As many bits as leave a draw and its distance from 1 exact. */
#if defined(STEADYTIP_FLOAT)
#define DRAW_BITS 23
#define DRAW_RANGE 8388608.0f
#else
#define DRAW_BITS 53
#define DRAW_RANGE 9007199254740992.0
#endif

static void draw(Instance *c) {
    Real *into = c->draws;
    int stream, j;
    for (stream = 0; stream < N_STREAMS; stream++) {
        const uint64_t seed = (uint64_t)c->now.value[STREAM[stream][0]];
        const int count = STREAM[stream][1];
        uint64_t word[4], first = c->now.samples * (uint64_t)count, block = UINT64_MAX;
        for (j = 0; j < count; j++) {
            uint64_t at = first + (uint64_t)j;
            if (at / 4 != block) {
                block = at / 4;
                philox(block + 1, seed, word); /* NumPy counts from 1 */
            }
            *into++ = ((Real)(word[at % 4] >> (64 - DRAW_BITS)) + (Real)0.5) / DRAW_RANGE;
        }
    }
}

/* ---- The model -------------------------------------------------------------------------------- */

static fmi2Status derive(Instance *c, const char *where) {
    const Real *arg[SZ_ARG + 1];
    Real *res[SZ_RES + 1];
    int i;
    arg[0] = c->now.value;
    res[0] = c->now.value + AT_D;
    MODEL_DERIVE(arg, res, c->iwork, c->work, 0);
    c->now.stale = 0;
    for (i = AT_D; i < AT_U; i++) {
        if (!within(&VARIABLE[i], c->now.value[i])) {
            begin(c, where);
            say(c, "the parameters give ");
            say(c, VARIABLE[i].name);
            say(c, " = ");
            say_number(c, c->now.value[i]);
            say(c, ", which");
            say_bounds(c, &VARIABLE[i]);
            return fail(c, fmi2Error);
        }
        if (VARIABLE[i].warning[0] != '\0' && c->now.value[i] == 0) {
            begin(c, where);
            say(c, VARIABLE[i].name);
            say(c, " is false: ");
            say(c, VARIABLE[i].warning);
            end(c, fmi2Warning);
        }
    }
    return fmi2OK;
}

/* Arguments p, d, u, x, r of the sample that comes next. */
static void lay_out(Instance *c, const Real *arg[]) {
    draw(c);
    arg[0] = c->now.value;
    arg[1] = c->now.value + AT_D;
    arg[2] = c->now.value + AT_U;
    arg[3] = c->now.value + AT_X;
    arg[4] = c->draws;
}

/* Whether all values are finite: else their sum is not. It is not either where finite ones sum up to
 * more than there is, which costs no more than looking again. Several sums, since one would wait. */
#define SUMS 16
static int all_finite(const Real *x, int n) {
    Real sum[SUMS] = {0};
    int i, j;
    for (i = 0; i + SUMS <= n; i += SUMS) {
        for (j = 0; j < SUMS; j++) sum[j] += x[i + j];
    }
    for (; i < n; i++) sum[0] += x[i];
    for (j = 1; j < SUMS; j++) sum[0] += sum[j];
    return isfinite(sum[0]);
}

/* Whether values are surely within limits that lie close together. */
static int surely_within(const Real *x, const double *low, const double *high, int n) {
    int i, outside = 0;
    for (i = 0; i < n; i++) outside |= !(x[i] >= low[i]) | !(x[i] <= high[i]);
    return !outside;
}

/* One sample into y_next and x_next, which follow each other as AT_Y and AT_X do; the instance
 * itself is not changed. */
static fmi2Status sample(Instance *c, const char *where, int starting) {
    const Real *arg[SZ_ARG + 1], *computed = c->y_next;
    Real *res[SZ_RES + 1];
    int i, span, limited = 0;
    lay_out(c, arg);
    res[0] = c->y_next + N_Y;
    res[1] = c->y_next;
    if (starting) MODEL_START(arg, res, c->iwork, c->work, 0);
    else MODEL_STEP(arg, res, c->iwork, c->work, 0);
    computed -= AT_Y;
    for (span = 0; span < N_SPANS; span++) {
        const int from = SPAN[span].from, to = SPAN[span].to, n = to - from, at = limited;
        if (!SPAN[span].loose) limited += n;
        /* One by one only where something is wrong, or in doubt. */
        if (SPAN[span].loose ? all_finite(computed + from, n)
                             : surely_within(computed + from, LOW + at, HIGH + at, n)) continue;
        for (i = from; i < to; i++) {
            if (!within(&VARIABLE[i], computed[i])) {
                begin(c, where);
                say(c, VARIABLE[i].name);
                say(c, " became ");
                say_number(c, computed[i]);
                say(c, " at t = ");
                say_number(c, c->now.start + (double)c->now.samples * MODEL_PERIOD);
                say(c, " s, it");
                say_bounds(c, &VARIABLE[i]);
                return fail(c, fmi2Error);
            }
        }
    }
    return fmi2OK;
}

/* Outputs and derived parameters as they stand before the first step. */
static fmi2Status initialise(Instance *c, const char *where) {
    if (!c->now.stale) return fmi2OK;
    if (derive(c, where) != fmi2OK || sample(c, where, 1) != fmi2OK) return fmi2Error;
    memcpy(c->now.value + AT_Y, c->y_next, N_Y * sizeof(Real));
    return fmi2OK;
}

static void start_over(Instance *c) {
    int i;
    memset(&c->now, 0, sizeof c->now);
    for (i = 0; i < N_VALUES; i++) c->now.value[i] = (Real)VARIABLE[i].start;
    c->now.mode = INSTANTIATED;
    c->now.stale = 1;
}

/* ---- Common functions ------------------------------------------------------------------------- */

EXPORT const char *FMI2(fmi2GetTypesPlatform)(void) { return "default"; }

EXPORT const char *FMI2(fmi2GetVersion)(void) { return "2.0"; }

EXPORT fmi2Component FMI2(fmi2Instantiate)(
    fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    Instance *c;
    const char *why = NULL, *p;
    (void)resources; /* none are needed */
    (void)visible;
    if (functions == NULL) return NULL;
    for (p = name; p != NULL && (*p == ' ' || *p == '\t' || *p == '\n' || *p == '\r'); p++) { }
    if (p == NULL || *p == '\0') {
        why = "the instance name is missing";
    } else if (type != fmi2CoSimulation) {
        why = "this FMU is for co-simulation, not for model exchange";
    } else if (guid == NULL || strcmp(guid, MODEL_GUID) != 0) {
        why = "the GUID is not the one of this binary, " MODEL_GUID
              "; take modelDescription.xml and binary from the same FMU";
    }
    c = why == NULL ? calloc(1, sizeof *c) : NULL;
    if (c != NULL) {
        c->name = calloc(strlen(name) + 1, 1);
        if (c->name == NULL) {
            free(c);
            c = NULL;
        }
    }
    if (c == NULL) {
        if (functions->logger != NULL) {
            functions->logger(
                functions->componentEnvironment, name != NULL ? name : "", fmi2Error,
                "logStatusError", "%s", why != NULL ? why : "fmi2Instantiate: out of memory");
        }
        return NULL;
    }
    strcpy(c->name, name);
    c->callbacks = *functions;
    c->logging = logging;
    start_over(c);
    return c;
}

EXPORT void FMI2(fmi2FreeInstance)(fmi2Component component) {
    Instance *c = component;
    if (c == NULL) return;
    free(c->name);
    free(c);
}

EXPORT fmi2Status FMI2(fmi2SetDebugLogging)(
    fmi2Component component, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    static const char *const known[] = {
        "logStatusWarning", "logStatusDiscard", "logStatusError", "logAll"};
    Instance *c = component;
    size_t i, j;
    if (!legal(c, "fmi2SetDebugLogging", ANY)) return fmi2Error;
    for (i = 0; i < n; i++) {
        for (j = 0; j < sizeof known / sizeof *known; j++) {
            if (categories != NULL && categories[i] != NULL && !strcmp(categories[i], known[j])) break;
        }
        if (j == sizeof known / sizeof *known) {
            return refuse(c, "fmi2SetDebugLogging", "unknown category; see LogCategories");
        }
    }
    c->logging = on;
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2SetupExperiment)(
    fmi2Component component, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
    fmi2Boolean has_stop, fmi2Real stop) {
    Instance *c = component;
    (void)has_tolerance;
    (void)tolerance; /* a sampled model has no integration error */
    if (!legal(c, "fmi2SetupExperiment", INSTANTIATED)) return fmi2Error;
    if (!isfinite(start) || (has_stop && !(isfinite(stop) && stop >= start))) {
        return refuse(c, "fmi2SetupExperiment", "start and stop time must be finite and in order");
    }
    c->now.start = c->now.time = start;
    c->now.has_stop = has_stop != 0;
    c->now.stop = has_stop ? stop : 0;
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2EnterInitializationMode)(fmi2Component component) {
    Instance *c = component;
    if (!legal(c, "fmi2EnterInitializationMode", INSTANTIATED)) return fmi2Error;
    c->now.mode = INITIALIZATION;
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2ExitInitializationMode)(fmi2Component component) {
    Instance *c = component;
    int i;
    if (!legal(c, "fmi2ExitInitializationMode", INITIALIZATION)) return fmi2Error;
    if (initialise(c, "fmi2ExitInitializationMode") != fmi2OK) return fmi2Error;
    for (i = 0; i < N_LATCHES; i++) {
        c->now.value[AT_X + LATCH[i][1]] = c->now.value[AT_Y + LATCH[i][0]];
    }
    c->now.mode = STEPPING;
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2Terminate)(fmi2Component component) {
    Instance *c = component;
    if (!legal(c, "fmi2Terminate", STEPPING)) return fmi2Error;
    c->now.mode = TERMINATED;
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2Reset)(fmi2Component component) {
    Instance *c = component;
    if (!legal(c, "fmi2Reset", ANY)) return fmi2Error;
    start_over(c);
    return fmi2OK;
}

/* ---- Values ------------------------------------------------------------------------------------ */

static fmi2Status locate(
    Instance *c, const char *where, const fmi2ValueReference vr[], size_t n, const void *values,
    Type type) {
    size_t i;
    if (n > 0 && (vr == NULL || values == NULL)) return refuse(c, where, "an array is missing");
    for (i = 0; i < n; i++) {
        if (vr[i] >= N_VALUES || VARIABLE[vr[i]].type != type) {
            begin(c, where);
            say(c, "no variable of this type has the value reference ");
            say_number(c, vr[i]);
            return end(c, fmi2Error);
        }
    }
    return fmi2OK;
}

static fmi2Status get(
    fmi2Component component, const char *where, const fmi2ValueReference vr[], size_t n,
    void *values, Type type) {
    Instance *c = component;
    size_t i;
    if (!legal(c, where, READABLE)) return fmi2Error;
    if (locate(c, where, vr, n, values, type) != fmi2OK) return fmi2Error;
    if (c->now.mode == INITIALIZATION && initialise(c, where) != fmi2OK) return fmi2Error;
    for (i = 0; i < n; i++) {
        Real value = c->now.value[vr[i]];
        if (type == REAL) ((double *)values)[i] = value;
        else ((int *)values)[i] = (int)value;
    }
    return fmi2OK;
}

static double element(const void *values, size_t i, Type type) {
    if (type == REAL) return ((const double *)values)[i];
    return type == BOOLEAN ? ((const int *)values)[i] != 0 : ((const int *)values)[i];
}

/* Sets all values or none. */
static fmi2Status set(
    fmi2Component component, const char *where, const fmi2ValueReference vr[], size_t n,
    const void *values, Type type) {
    Instance *c = component;
    size_t i;
    if (!legal(c, where, INSTANTIATED | INITIALIZATION | STEPPING)) return fmi2Error;
    if (locate(c, where, vr, n, values, type) != fmi2OK) return fmi2Error;
    for (i = 0; i < n; i++) {
        const Variable *v = &VARIABLE[vr[i]];
        double value = element(values, i, type);
        int input = vr[i] >= AT_U && vr[i] < AT_Y, parameter = vr[i] < AT_D;
        begin(c, where);
        say(c, v->name);
        if (!input && !parameter) {
            say(c, " is computed and cannot be set");
            return end(c, fmi2Error);
        }
        if (parameter && c->now.mode == STEPPING && !v->tunable) {
            say(c, " is a fixed parameter: set it before fmi2ExitInitializationMode");
            return end(c, fmi2Error);
        }
        if (!within(v, (Real)value)) {
            say(c, " = ");
            say_number(c, value);
            say_bounds(c, v);
            return end(c, fmi2Discard);
        }
    }
    for (i = 0; i < n; i++) {
        c->now.value[vr[i]] = (Real)element(values, i, type);
        if (vr[i] < AT_D || c->now.mode != STEPPING) c->now.stale = 1;
    }
    return fmi2OK;
}

#define ACCESS(Name, CType, TYPE) \
    EXPORT fmi2Status FMI2(fmi2Get##Name)( \
        fmi2Component c, const fmi2ValueReference vr[], size_t n, CType values[]) { \
        return get(c, "fmi2Get" #Name, vr, n, values, TYPE); \
    } \
    EXPORT fmi2Status FMI2(fmi2Set##Name)( \
        fmi2Component c, const fmi2ValueReference vr[], size_t n, const CType values[]) { \
        return set(c, "fmi2Set" #Name, vr, n, values, TYPE); \
    }

ACCESS(Real, fmi2Real, REAL)
ACCESS(Integer, fmi2Integer, INTEGER)
ACCESS(Boolean, fmi2Boolean, BOOLEAN)
ACCESS(String, fmi2String, STRING) /* no variable is one: any value reference is refused */

/* ---- States ------------------------------------------------------------------------------------ */

EXPORT fmi2Status FMI2(fmi2GetFMUstate)(fmi2Component component, fmi2FMUstate *state) {
    Instance *c = component;
    State *s;
    if (!legal(c, "fmi2GetFMUstate", ANY)) return fmi2Error;
    if (state == NULL) return refuse(c, "fmi2GetFMUstate", "the state's place is missing");
    s = *state != NULL ? *state : calloc(1, sizeof *s);
    if (s == NULL) return refuse(c, "fmi2GetFMUstate", "out of memory");
    if (*state != NULL && s->magic != STATE_MAGIC) {
        return refuse(c, "fmi2GetFMUstate", "the handle to fill is not a state of this FMU");
    }
    s->magic = STATE_MAGIC;
    s->memory = c->now;
    *state = s;
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2SetFMUstate)(fmi2Component component, fmi2FMUstate state) {
    Instance *c = component;
    const State *s = state;
    if (!legal(c, "fmi2SetFMUstate", ANY)) return fmi2Error;
    if (s == NULL || s->magic != STATE_MAGIC) {
        return refuse(c, "fmi2SetFMUstate", "the handle is not a state of this FMU");
    }
    c->now = s->memory;
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2FreeFMUstate)(fmi2Component component, fmi2FMUstate *state) {
    Instance *c = component;
    if (!legal(c, "fmi2FreeFMUstate", ANY)) return fmi2Error;
    if (state == NULL || *state == NULL) return fmi2OK;
    if (((State *)*state)->magic != STATE_MAGIC) {
        return refuse(c, "fmi2FreeFMUstate", "the handle is not a state of this FMU");
    }
    ((State *)*state)->magic = 0;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

/* Serialised: magic, layout version, GUID, count of values, values, times, counters, CRC-32; all
 * little-endian, doubles as their IEEE 754 bits, so that the bytes mean the same on every machine. */
#define GUID_BYTES (sizeof MODEL_GUID - 1)
#define SERIALIZED (4 + 4 + GUID_BYTES + 4 + 8 * (N_VALUES + 3 + 1) + 3 * 4 + 4)

static void put(fmi2Byte **at, uint64_t value, int bytes) {
    for (; bytes > 0; bytes--, value >>= 8) *(*at)++ = (fmi2Byte)(value & 0xFF);
}

static uint64_t take(const fmi2Byte **at, int bytes) {
    uint64_t value = 0;
    int i;
    for (i = 0; i < bytes; i++) value |= (uint64_t)(unsigned char)*(*at)++ << (8 * i);
    return value;
}

static uint64_t bits(double value) {
    uint64_t word;
    memcpy(&word, &value, sizeof word);
    return word;
}

static double number(uint64_t word) {
    double value;
    memcpy(&value, &word, sizeof value);
    return value;
}

EXPORT fmi2Status FMI2(fmi2SerializedFMUstateSize)(
    fmi2Component component, fmi2FMUstate state, size_t *size) {
    Instance *c = component;
    if (!legal(c, "fmi2SerializedFMUstateSize", ANY)) return fmi2Error;
    if (state == NULL || ((State *)state)->magic != STATE_MAGIC || size == NULL) {
        return refuse(c, "fmi2SerializedFMUstateSize", "state or size is missing");
    }
    *size = SERIALIZED;
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2SerializeFMUstate)(
    fmi2Component component, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    Instance *c = component;
    const State *s = state;
    fmi2Byte *at = bytes;
    int i;
    if (!legal(c, "fmi2SerializeFMUstate", ANY)) return fmi2Error;
    if (s == NULL || s->magic != STATE_MAGIC || bytes == NULL || size < SERIALIZED) {
        return refuse(c, "fmi2SerializeFMUstate", "state missing, or too few bytes for it");
    }
    put(&at, STATE_MAGIC, 4);
    put(&at, LAYOUT_VERSION, 4);
    memcpy(at, MODEL_GUID, GUID_BYTES);
    at += GUID_BYTES;
    put(&at, N_VALUES, 4);
    for (i = 0; i < N_VALUES; i++) put(&at, bits(s->memory.value[i]), 8);
    put(&at, bits(s->memory.start), 8);
    put(&at, bits(s->memory.stop), 8);
    put(&at, bits(s->memory.time), 8);
    put(&at, s->memory.samples, 8);
    put(&at, s->memory.mode, 4);
    put(&at, s->memory.has_stop, 4);
    put(&at, s->memory.stale, 4);
    put(&at, crc32(bytes, SERIALIZED - 4), 4);
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2DeSerializeFMUstate)(
    fmi2Component component, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    static const char where[] = "fmi2DeSerializeFMUstate";
    Instance *c = component;
    const fmi2Byte *at = bytes;
    State *s;
    uint32_t mode;
    int i;
    if (!legal(c, where, ANY)) return fmi2Error;
    if (bytes == NULL || state == NULL) return refuse(c, where, "bytes or state is missing");
    if (size != SERIALIZED) return refuse(c, where, "the length is not that of a state of this FMU");
    if (take(&at, 4) != STATE_MAGIC || take(&at, 4) != LAYOUT_VERSION) {
        return refuse(c, where, "these bytes are not a state in this version's layout");
    }
    if (memcmp(at, MODEL_GUID, GUID_BYTES) != 0) {
        return refuse(c, where, "the state is that of an FMU with another GUID");
    }
    at = bytes + SERIALIZED - 4;
    if (take(&at, 4) != crc32(bytes, SERIALIZED - 4)) {
        return refuse(c, where, "the checksum does not match: the bytes were damaged");
    }
    /* A checksum is easily made: look at the values, too. */
    at = bytes + 8 + GUID_BYTES + 4;
    for (i = 0; i < N_VALUES; i++) {
        if (!within(&VARIABLE[i], (Real)number(take(&at, 8)))) {
            begin(c, where);
            say(c, VARIABLE[i].name);
            say(c, " in the state");
            say_bounds(c, &VARIABLE[i]);
            return end(c, fmi2Error);
        }
    }
    for (i = 0; i < 3; i++) {
        if (!isfinite(number(take(&at, 8)))) return refuse(c, where, "a time is not finite");
    }
    at += 8;
    mode = (uint32_t)take(&at, 4);
    if (mode == 0 || (mode & (mode - 1)) != 0 || mode > FAILED) {
        return refuse(c, where, "the mode of the state is none of FMI's");
    }
    if (*state != NULL && ((State *)*state)->magic != STATE_MAGIC) {
        return refuse(c, where, "the handle to fill is not a state of this FMU");
    }
    s = *state != NULL ? *state : calloc(1, sizeof *s);
    if (s == NULL) return refuse(c, where, "out of memory");
    s->magic = STATE_MAGIC;
    at = bytes + 8 + GUID_BYTES + 4;
    for (i = 0; i < N_VALUES; i++) s->memory.value[i] = (Real)number(take(&at, 8));
    s->memory.start = number(take(&at, 8));
    s->memory.stop = number(take(&at, 8));
    s->memory.time = number(take(&at, 8));
    s->memory.samples = take(&at, 8);
    s->memory.mode = (uint32_t)take(&at, 4);
    s->memory.has_stop = (uint32_t)take(&at, 4);
    s->memory.stale = (uint32_t)take(&at, 4);
    *state = s;
    return fmi2OK;
}

/* ---- Co-simulation ------------------------------------------------------------------------------ */

EXPORT fmi2Status FMI2(fmi2DoStep)(
    fmi2Component component, fmi2Real t, fmi2Real h, fmi2Boolean no_set_state) {
    static const char where[] = "fmi2DoStep";
    Instance *c = component;
    double until, due;
    (void)no_set_state;
    if (!legal(c, where, STEPPING)) return fmi2Error;
    begin(c, where);
    if (!(isfinite(h) && h > 0)) {
        say(c, "communicationStepSize = ");
        say_number(c, h);
        say(c, " must be finite and greater than 0 s");
        return end(c, fmi2Error);
    }
    /* Both ways of keeping time are right: n h, and adding h up. */
    if (!isfinite(t) || fabs(t - c->now.time) > 1e-9 * h + 16 * DBL_EPSILON * (fabs(t) + h)) {
        say(c, "currentCommunicationPoint = ");
        say_number(c, t);
        say(c, " must be the end of the step before, ");
        say_number(c, c->now.time);
        say(c, " s");
        return end(c, fmi2Error);
    }
    until = t + h;
    if (c->now.has_stop && until > c->now.stop + 1e-9 * h + 16 * DBL_EPSILON * fabs(until)) {
        say(c, "the step ends at ");
        say_number(c, until);
        say(c, " s, after the stop time of ");
        say_number(c, c->now.stop);
        say(c, " s");
        return end(c, fmi2Error);
    }
    /* An instant that rounding puts a hair before the end of a step belongs to the next one. */
    due = ceil((until - c->now.start) / MODEL_PERIOD - 1e-3);
    if (due - (double)c->now.samples > MOST_SAMPLES) {
        say(c, "communicationStepSize = ");
        say_number(c, h);
        say(c, " s holds more than 1e6 samples; take shorter steps");
        return end(c, fmi2Discard);
    }
    if (c->now.stale && derive(c, where) != fmi2OK) return fmi2Error;
    while ((double)c->now.samples < due) {
        if (sample(c, where, 0) != fmi2OK) return fmi2Error;
        memcpy(c->now.value + AT_Y, c->y_next, (N_Y + N_X) * sizeof(Real));
        c->now.samples++;
    }
    c->now.time = until;
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2CancelStep)(fmi2Component component) {
    Instance *c = component;
    if (c == NULL) return fmi2Error;
    return refuse(c, "fmi2CancelStep", "no step runs asynchronously");
}

EXPORT fmi2Status FMI2(fmi2GetStatus)(
    fmi2Component component, const fmi2StatusKind kind, fmi2Status *value) {
    Instance *c = component;
    (void)kind;
    (void)value;
    if (c == NULL) return fmi2Error;
    refuse(c, "fmi2GetStatus", "no step runs asynchronously, so none has a status to ask for");
    return fmi2Discard;
}

EXPORT fmi2Status FMI2(fmi2GetRealStatus)(
    fmi2Component component, const fmi2StatusKind kind, fmi2Real *value) {
    Instance *c = component;
    if (!legal(c, "fmi2GetRealStatus", STEPPING | TERMINATED | FAILED)) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime || value == NULL) {
        refuse(c, "fmi2GetRealStatus", "the only real status is fmi2LastSuccessfulTime");
        return fmi2Discard;
    }
    *value = c->now.time;
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2GetIntegerStatus)(
    fmi2Component component, const fmi2StatusKind kind, fmi2Integer *value) {
    Instance *c = component;
    (void)kind;
    (void)value;
    if (c == NULL) return fmi2Error;
    refuse(c, "fmi2GetIntegerStatus", "there is no integer status");
    return fmi2Discard;
}

EXPORT fmi2Status FMI2(fmi2GetBooleanStatus)(
    fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value) {
    Instance *c = component;
    if (!legal(c, "fmi2GetBooleanStatus", STEPPING | TERMINATED | FAILED)) return fmi2Error;
    if (kind != fmi2Terminated || value == NULL) {
        refuse(c, "fmi2GetBooleanStatus", "the only boolean status is fmi2Terminated");
        return fmi2Discard;
    }
    *value = 0; /* a model never ends a run by itself */
    return fmi2OK;
}

EXPORT fmi2Status FMI2(fmi2GetStringStatus)(
    fmi2Component component, const fmi2StatusKind kind, fmi2String *value) {
    Instance *c = component;
    (void)kind;
    (void)value;
    if (c == NULL) return fmi2Error;
    refuse(c, "fmi2GetStringStatus", "no step is ever pending");
    return fmi2Discard;
}

EXPORT fmi2Status FMI2(fmi2SetRealInputDerivatives)(
    fmi2Component component, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
    const fmi2Real value[]) {
    Instance *c = component;
    (void)vr;
    (void)n;
    (void)order;
    (void)value;
    if (c == NULL) return fmi2Error;
    return refuse(c, "fmi2SetRealInputDerivatives", "inputs are held, canInterpolateInputs is false");
}

EXPORT fmi2Status FMI2(fmi2GetRealOutputDerivatives)(
    fmi2Component component, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
    fmi2Real value[]) {
    Instance *c = component;
    (void)vr;
    (void)n;
    (void)order;
    (void)value;
    if (c == NULL) return fmi2Error;
    return refuse(c, "fmi2GetRealOutputDerivatives", "maxOutputDerivativeOrder is 0");
}

/* How the outputs of the sample that comes next answer a change of its inputs; in initialisation
 * mode that is how the outputs answer at once. */
EXPORT fmi2Status FMI2(fmi2GetDirectionalDerivative)(
    fmi2Component component, const fmi2ValueReference unknown[], size_t n_unknown,
    const fmi2ValueReference known[], size_t n_known, const fmi2Real known_change[],
    fmi2Real unknown_change[]) {
    static const char where[] = "fmi2GetDirectionalDerivative";
    Instance *c = component;
#if !defined(MODEL_SLOPE)
    (void)unknown;
    (void)n_unknown;
    (void)known;
    (void)n_known;
    (void)known_change;
    (void)unknown_change;
    if (c == NULL) return fmi2Error;
    return refuse(c, where, "providesDirectionalDerivative is false");
#else
    const Real *arg[SZ_ARG + 1];
    Real *res[SZ_RES + 1];
    size_t i;
    if (!legal(c, where, READABLE)) return fmi2Error;
    if (locate(c, where, unknown, n_unknown, unknown_change, REAL) != fmi2OK) return fmi2Error;
    if (locate(c, where, known, n_known, known_change, REAL) != fmi2OK) return fmi2Error;
    for (i = 0; i < n_unknown; i++) {
        if (unknown[i] < AT_Y || unknown[i] >= AT_X) {
            return refuse(c, where, "unknowns are outputs only");
        }
    }
    memset(c->du, 0, sizeof c->du);
    for (i = 0; i < n_known; i++) {
        if (known[i] < AT_U || known[i] >= AT_Y) return refuse(c, where, "knowns are inputs only");
        c->du[known[i] - AT_U] += (Real)known_change[i];
    }
    if (c->now.stale && derive(c, where) != fmi2OK) return fmi2Error;
    lay_out(c, arg);
    arg[5] = c->du;
    res[0] = c->y_next;
    MODEL_SLOPE(arg, res, c->iwork, c->work, 0);
    for (i = 0; i < n_unknown; i++) {
        unknown_change[i] = c->y_next[unknown[i] - AT_Y];
        if (!isfinite(unknown_change[i])) return refuse(c, where, "no derivative exists here");
    }
    return fmi2OK;
#endif
}
