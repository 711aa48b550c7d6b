/* An FMI 2.0 co-simulation FMU by "somebody else": nothing of the project is in it.
 *
 * y = gain * u, count = steps taken + add, off = !on. With the parameter `mode` it misbehaves in the
 * step that holds the time `at`. Compiled with -DDEFECT=... it is wrong in one known way throughout;
 * without, it keeps to the standard.
 */
#include <fenv.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <windows.h>
#define EXPORT __declspec(dllexport)
static void pause_ms(int ms) { Sleep(ms); }
#else
#include <time.h>
#define EXPORT __attribute__((visibility("default")))
static void pause_ms(int ms) {
    struct timespec span = {ms / 1000, (ms % 1000) * 1000000L};
    nanosleep(&span, NULL);
}
#endif

enum {
    NONE, ACCEPTS_ANY_GUID, CRASHES_ON_NULL_NAME, CRASHES_WITHOUT_LOGGER, KEEPS_POINTERS,
    USES_TEXT_AS_FORMAT, INVENTS_A_CATEGORY, PASSES_NAN, SETS_HALF, SETS_FIXED, SETS_OUTPUTS,
    ANOTHER_START, HANGS_ON_NAN_STEP, ACCEPTS_ANY_TIME, STEPS_PAST_STOP, ONLY_FROM_ZERO,
    DRIFTS_IN_TIME, NO_STATE_MACHINE, KEEPS_ON_RESET, FORGETS_A_MEMBER, ACCEPTS_DAMAGE,
    CRASHES_ON_DAMAGE, LEAKS_STATES, LEAKS_INSTANCES, ONE_FOR_ALL, PRINTS, ROUNDS_UP,
    WRONG_DERIVATIVE, REFUSES_LEGAL_CALLS, ANOTHER_VERSION
};
#ifndef DEFECT
#define DEFECT NONE
#endif

static void crash(void) {
    int *volatile nowhere = NULL;
    *(int volatile *)nowhere = 1;
}

typedef void *Component;
typedef unsigned int Reference;
typedef double Real;
typedef int Integer, Boolean, Status, Type;
typedef const char *String;
typedef void (*Logger)(void *, String, Status, String, String, ...);
typedef struct {
    Logger logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, Status);
    void *environment;
} Callbacks;

enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum {
    GAIN_BLOCK, FAILS, GIVES_NAN, HANGS, IS_SLOW, IS_FATAL, DISCARDS, FAILS_TO_START, SEGFAULTS,
    EXITS, CRASHES_TO_START
};
/* value references, and what each may be used for */
enum { U, Y, GAIN, MODE, AT, COUNT, ADD, ON, OFF, SEED, W1, W2, W3, N };
static const char TYPES[] = "RRRIRIIBBIRRR", ROLES[] = "iopppoiiopppp";
static const Real LOW[N] = {-100, -HUGE_VAL, -10, -HUGE_VAL, -HUGE_VAL, -HUGE_VAL, -HUGE_VAL, 0, 0, 0,
                            -HUGE_VAL, -HUGE_VAL, -HUGE_VAL};
static const Real HIGH[N] = {100, HUGE_VAL, 10, HUGE_VAL, HUGE_VAL, HUGE_VAL, HUGE_VAL, 1, 1, 1000,
                             HUGE_VAL, HUGE_VAL, HUGE_VAL};

enum { INSTANTIATED = 1, INITIALIZING = 2, STEPPING = 4, TERMINATED = 8, ANY = 15 };

typedef struct {
    Real r[N];
    Integer i[N];
    Integer steps, mode, stops;
    Real time, stop;
} Memory;

typedef struct {
    Callbacks callbacks, *theirs;
    char name[200];
    String their_name;
    Memory now;
} Probe;

static int the_steps; /* only for ONE_FOR_ALL */

static Status say(Probe *p, Status status, String text, Real value) {
    const Callbacks *to = DEFECT == KEEPS_POINTERS ? p->theirs : &p->callbacks;
    String name = DEFECT == KEEPS_POINTERS ? p->their_name : p->name;
    String category = DEFECT == INVENTS_A_CATEGORY ? "chatter"
                      : status == DISCARD          ? "logStatusDiscard"
                                                   : "logStatusError";
    if (!to->logger && DEFECT != CRASHES_WITHOUT_LOGGER && DEFECT != KEEPS_POINTERS) return status;
    if (!to->logger && DEFECT == KEEPS_POINTERS) crash();
    if (DEFECT == USES_TEXT_AS_FORMAT) to->logger(to->environment, name, status, category, name);
    to->logger(to->environment, name, status, category, text, value);
    return status;
}

static int legal(Probe *p, int modes) {
    if (!p) return 0;
    if (p->now.mode & modes || DEFECT == NO_STATE_MACHINE) return 1;
    say(p, ERROR, "not now (%g)", p->now.mode);
    return 0;
}

static void update(Probe *p) {
    if (DEFECT == ONE_FOR_ALL) p->now.steps = the_steps;
    p->now.r[Y] = p->now.r[GAIN] * p->now.r[U];
    p->now.i[COUNT] = p->now.steps + p->now.i[ADD];
    p->now.i[OFF] = !p->now.i[ON];
}

static void begin(Probe *p) {
    int steps = p->now.steps;
    memset(&p->now, 0, sizeof p->now);
    if (DEFECT == KEEPS_ON_RESET) p->now.steps = steps;
    p->now.r[GAIN] = DEFECT == ANOTHER_START ? 2.0 : 1.0;
    p->now.mode = INSTANTIATED;
    update(p);
}

EXPORT String fmi2GetTypesPlatform(void) { return "default"; }
EXPORT String fmi2GetVersion(void) { return DEFECT == ANOTHER_VERSION ? "2.0.5" : "2.0"; }

EXPORT Component fmi2Instantiate(String name, Type type, String guid, String resources,
                                 const Callbacks *callbacks, Boolean visible, Boolean logging) {
    (void)resources, (void)visible, (void)logging;
    if (DEFECT == PRINTS) puts("hello");
    if (!callbacks) return NULL;
    Probe *p = calloc(1, sizeof *p);
    if (!p) return NULL;
    if (!name && DEFECT == CRASHES_ON_NULL_NAME) crash();
    p->callbacks = *callbacks;
    p->theirs = (Callbacks *)callbacks;
    p->their_name = name;
    strncpy(p->name, name ? name : "", sizeof p->name - 1);
    if (!name || strspn(name, " \t\r\n") == strlen(name) || type != 1) {
        say(p, ERROR, "wrong name or type %g", type);
        free(p);
        return NULL;
    }
    if ((!guid || strcmp(guid, "probe-1") != 0) && DEFECT != ACCEPTS_ANY_GUID) {
        if (callbacks->logger)
            callbacks->logger(callbacks->environment, "probe", ERROR, "logStatusError",
                              "the GUID is '%s', not 'probe-1'", guid ? guid : "NULL");
        free(p);
        return NULL;
    }
    begin(p);
    return p;
}

EXPORT void fmi2FreeInstance(Component c) {
    if (DEFECT != LEAKS_INSTANCES) free(c);
}
EXPORT Status fmi2SetDebugLogging(Component c, Boolean on, size_t n, const String names[]) {
    (void)on;
    if (!legal(c, ANY)) return ERROR;
    for (size_t k = 0; k < n; ++k)
        if (strcmp(names[k], "logStatusDiscard") && strcmp(names[k], "logStatusError"))
            return say(c, ERROR, "unknown category %g", (Real)k);
    return OK;
}
EXPORT Status fmi2SetupExperiment(Component c, Boolean defined, Real tolerance, Real start,
                                  Boolean stops, Real stop) {
    Probe *p = c;
    (void)defined, (void)tolerance;
    if (!legal(p, INSTANTIATED)) return ERROR;
    if (DEFECT == ONLY_FROM_ZERO && start < 0) return say(p, ERROR, "not from %g s", start);
    p->now.time = start;
    p->now.stops = stops;
    p->now.stop = stop;
    return OK;
}
EXPORT Status fmi2EnterInitializationMode(Component c) {
    Probe *p = c;
    if (!legal(p, INSTANTIATED)) return ERROR;
    p->now.mode = INITIALIZING;
    return OK;
}
EXPORT Status fmi2ExitInitializationMode(Component c) {
    Probe *p = c;
    if (!legal(p, INITIALIZING)) return ERROR;
    if (p->now.i[MODE] == FAILS_TO_START)
        return say(p, ERROR, "gain %g does not suit me", p->now.r[GAIN]);
    if (p->now.i[MODE] == CRASHES_TO_START) crash();
    update(p);
    p->now.mode = STEPPING;
    return OK;
}
EXPORT Status fmi2Terminate(Component c) {
    Probe *p = c;
    if (!legal(p, STEPPING)) return ERROR;
    p->now.mode = TERMINATED;
    return DEFECT == REFUSES_LEGAL_CALLS ? ERROR : OK;
}
EXPORT Status fmi2Reset(Component c) {
    if (!legal(c, ANY)) return ERROR;
    begin(c);
    return OK;
}

static Status set(Probe *p, const Reference vr[], size_t n, const Real *r, const Integer *i, char type) {
    if (!legal(p, INSTANTIATED | INITIALIZING | STEPPING)) return ERROR;
    if (n && (!vr || (!r && !i))) return say(p, ERROR, "no arrays for %g values", (Real)n);
    for (size_t k = 0; k < n; ++k) {
        if (vr[k] >= N || TYPES[vr[k]] != type) return say(p, ERROR, "no variable %g", vr[k]);
        Real value = r ? r[k] : i[k];
        if (ROLES[vr[k]] == 'o' && DEFECT != SETS_OUTPUTS)
            return say(p, ERROR, "%g is an output", vr[k]);
        if (ROLES[vr[k]] == 'p' && p->now.mode == STEPPING && DEFECT != SETS_FIXED)
            return say(p, ERROR, "%g is fixed", vr[k]);
        if (!(value >= LOW[vr[k]] && value <= HIGH[vr[k]]) && DEFECT != PASSES_NAN)
            return say(p, DISCARD, vr[k] == U ? "u = %g is too much for me" : "not %g", value);
        if (DEFECT == SETS_HALF && r) p->now.r[vr[k]] = value;
    }
    for (size_t k = 0; k < n; ++k) {
        if (r) p->now.r[vr[k]] = r[k];
        else p->now.i[vr[k]] = i[k];
    }
    if (p->now.mode != STEPPING) update(p);
    return OK;
}
static Status get(Probe *p, const Reference vr[], size_t n, Real *r, Integer *i, char type) {
    if (!legal(p, INITIALIZING | STEPPING | TERMINATED)) return ERROR;
    if (n && (!vr || (!r && !i))) return say(p, ERROR, "no arrays for %g values", (Real)n);
    for (size_t k = 0; k < n; ++k) {
        if (vr[k] >= N || TYPES[vr[k]] != type) return say(p, ERROR, "no variable %g", vr[k]);
        if (r) r[k] = p->now.r[vr[k]];
        else i[k] = p->now.i[vr[k]];
    }
    return OK;
}
EXPORT Status fmi2SetReal(Component c, const Reference vr[], size_t n, const Real value[]) {
    return set(c, vr, n, value, NULL, 'R');
}
EXPORT Status fmi2GetReal(Component c, const Reference vr[], size_t n, Real value[]) {
    return get(c, vr, n, value, NULL, 'R');
}
EXPORT Status fmi2SetInteger(Component c, const Reference vr[], size_t n, const Integer value[]) {
    return set(c, vr, n, NULL, value, 'I');
}
EXPORT Status fmi2GetInteger(Component c, const Reference vr[], size_t n, Integer value[]) {
    return get(c, vr, n, NULL, value, 'I');
}
EXPORT Status fmi2SetBoolean(Component c, const Reference vr[], size_t n, const Boolean value[]) {
    return set(c, vr, n, NULL, value, 'B');
}
EXPORT Status fmi2GetBoolean(Component c, const Reference vr[], size_t n, Boolean value[]) {
    return get(c, vr, n, NULL, value, 'B');
}

EXPORT Status fmi2DoStep(Component c, Real t, Real h, Boolean forget) {
    Probe *p = c;
    (void)forget;
    if (!legal(p, STEPPING)) return ERROR;
    if (DEFECT == HANGS_ON_NAN_STEP)
        while (isnan(h)) pause_ms(50);
    if (!(h > 0 && isfinite(h))) return say(p, ERROR, "no step of %g s", h);
    Real near = DEFECT == DRIFTS_IN_TIME ? 0.0 : 1e-9 * h + 1e-12 * fabs(t);
    if (!(fabs(t - p->now.time) <= near) && DEFECT != ACCEPTS_ANY_TIME)
        return say(p, ERROR, "no step from %g s", t);
    if (p->now.stops && t + h > p->now.stop + 1e-6 * h && DEFECT != STEPS_PAST_STOP)
        return say(p, ERROR, "no step past %g s", p->now.stop);
    if (DEFECT == ROUNDS_UP) fesetround(FE_UPWARD);
    ++p->now.steps;
    if (DEFECT == ONE_FOR_ALL) ++the_steps;
    update(p);
    p->now.time = t + h;
    if (t + h <= p->now.r[AT]) return OK;
    switch (p->now.i[MODE]) {
    case FAILS: return say(p, ERROR, "no more after %g s", t);
    case GIVES_NAN: p->now.r[Y] = NAN; return OK;
    case HANGS: for (;;) pause_ms(50);
    case IS_SLOW: pause_ms(1500); return OK;
    case IS_FATAL: return FATAL;
    case DISCARDS: return DISCARD;
    case SEGFAULTS: crash(); return OK;
    case EXITS: exit(3);
    default: return OK;
    }
}

/* States: the memory and a sum of its bytes. */
typedef struct {
    Memory memory;
    size_t sum; /* no padding behind it, which no sum would guard */
} State;

static size_t sum(const Memory *m) {
    size_t total = 5381;
    for (size_t k = 0; k < sizeof *m; ++k) total = total * 33 + ((const unsigned char *)m)[k];
    return total;
}
EXPORT Status fmi2GetFMUstate(Component c, State **state) {
    Probe *p = c;
    if (!legal(p, ANY) || !state) return ERROR;
    if (!*state || DEFECT == LEAKS_STATES) *state = calloc(1, sizeof **state);
    (*state)->memory = p->now;
    (*state)->sum = sum(&p->now);
    return OK;
}
EXPORT Status fmi2SetFMUstate(Component c, State *state) {
    Probe *p = c;
    if (!legal(p, ANY) || !state) return ERROR;
    int steps = p->now.steps;
    p->now = state->memory;
    if (DEFECT == FORGETS_A_MEMBER) p->now.steps = steps;
    return OK;
}
EXPORT Status fmi2FreeFMUstate(Component c, State **state) {
    if (!legal(c, ANY)) return ERROR;
    if (!state) return OK;
    free(*state);
    *state = NULL;
    return OK;
}
EXPORT Status fmi2SerializedFMUstateSize(Component c, State *state, size_t *size) {
    if (!legal(c, ANY) || !state || !size) return ERROR;
    *size = sizeof *state;
    return OK;
}
EXPORT Status fmi2SerializeFMUstate(Component c, State *state, char bytes[], size_t size) {
    if (!legal(c, ANY) || !state || !bytes || size < sizeof *state) return ERROR;
    memcpy(bytes, state, sizeof *state);
    return OK;
}
EXPORT Status fmi2DeSerializeFMUstate(Component c, const char bytes[], size_t size, State **state) {
    State found;
    if (!legal(c, ANY) || !bytes || !state || size != sizeof found) return ERROR;
    memcpy(&found, bytes, sizeof found);
    if (sum(&found.memory) != found.sum) {
        if (DEFECT == CRASHES_ON_DAMAGE) crash();
        if (DEFECT != ACCEPTS_DAMAGE) return say(c, ERROR, "the sum is not %g", found.sum);
    }
    if (!*state) *state = calloc(1, sizeof **state);
    **state = found;
    return OK;
}

EXPORT Status fmi2GetDirectionalDerivative(Component c, const Reference unknown[], size_t n_unknown,
                                           const Reference known[], size_t n_known,
                                           const Real change[], Real result[]) {
    Probe *p = c;
    if (!legal(p, INITIALIZING | STEPPING | TERMINATED)) return ERROR;
    for (size_t k = 0; k < n_unknown; ++k) {
        result[k] = 0.0;
        for (size_t j = 0; j < n_known; ++j)
            if (unknown[k] == Y && known[j] == U) result[k] += p->now.r[GAIN] * change[j];
        if (DEFECT == WRONG_DERIVATIVE) result[k] += 0.5;
    }
    return OK;
}
EXPORT Status fmi2GetRealStatus(Component c, int kind, Real *value) {
    Probe *p = c;
    if (!legal(p, STEPPING | TERMINATED)) return ERROR;
    if (kind != 2 || !value) return DISCARD;
    *value = p->now.time;
    return OK;
}

#ifdef WITH_MORE_SYMBOLS
EXPORT int step(void) { return 1; }
#endif

/* The rest of the standard's functions. */
#define UNSUPPORTED(name) EXPORT Status name(Component c) { (void)c; return ERROR; }
#ifndef WITH_FEWER_SYMBOLS
UNSUPPORTED(fmi2CancelStep)
#endif
UNSUPPORTED(fmi2SetString)
UNSUPPORTED(fmi2GetString)
UNSUPPORTED(fmi2SetRealInputDerivatives)
UNSUPPORTED(fmi2GetRealOutputDerivatives)
UNSUPPORTED(fmi2GetStatus)
UNSUPPORTED(fmi2GetIntegerStatus)
UNSUPPORTED(fmi2GetBooleanStatus)
UNSUPPORTED(fmi2GetStringStatus)
