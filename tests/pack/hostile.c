/* A hostile host around one FMU's sources, to be built with sanitizers.
 *
 *   hostile walk SEEDS     random calls, legal and not, with odd arguments; after each it is checked
 *                          that a refused call changed nothing and that readable values are finite
 *   hostile threads        100 instances in 8 threads against one after the other, to the bit
 *
 * With -DFUZZER it is a libFuzzer target: the bytes choose the calls of `walk`.
 */
#include <assert.h>
#include <stdlib.h>

static __thread long allocations; /* of this thread */
static void *counting_calloc(size_t n, size_t size) {
    allocations++;
    return calloc(n, size);
}
#define calloc counting_calloc
#include "fmu.c"
#undef calloc

#include <pthread.h>
#include <stdio.h>

static __thread long messages, steps;

static void listen(
    fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
    fmi2String format, ...) {
    (void)e;
    (void)status;
    assert(name != NULL && category != NULL && strcmp(format, "%s") == 0);
    messages++;
}

/* ---- Bytes that decide ---------------------------------------------------------------------- */

typedef struct {
    const unsigned char *at, *end;
} Bytes;

static unsigned pick(Bytes *b, unsigned n) {
    unsigned value = b->at < b->end ? *b->at++ : 0;
    value = value << 8 | (b->at < b->end ? *b->at++ : 0);
    return value % n;
}

static double odd_number(Bytes *b, const Variable *v) {
    switch (pick(b, 9)) {
    case 0: return NAN;
    case 1: return INFINITY;
    case 2: return -INFINITY;
    case 3: return 1e300;
    case 4: return v->min;
    case 5: return v->max;
    case 6: return v->max * 1.0000001 + 1e-9;
    default: return v->start;
    }
}

static int same(const Memory *a, const Memory *b) { return memcmp(a, b, sizeof *a) == 0; }

static void check_finite(const Instance *c) {
    int i;
    for (i = 0; i < N_VALUES; i++) assert(isfinite(c->now.value[i]));
}

#define STATES 3

static void walk(Bytes *b) {
    fmi2CallbackFunctions functions = {listen, NULL, NULL, NULL, NULL};
    fmi2FMUstate state[STATES] = {NULL, NULL, NULL};
    fmi2Component c;
    Memory before;
    long allocated;
    if (pick(b, 4) == 0) functions.logger = NULL;
    assert(fmi2Instantiate(NULL, fmi2CoSimulation, MODEL_GUID, NULL, &functions, 0, 0) == NULL);
    assert(fmi2Instantiate(" ", fmi2CoSimulation, MODEL_GUID, "", &functions, 0, 0) == NULL);
    assert(fmi2Instantiate("a", fmi2ModelExchange, MODEL_GUID, "", &functions, 0, 0) == NULL);
    assert(fmi2Instantiate("a", fmi2CoSimulation, NULL, "", &functions, 0, 0) == NULL);
    assert(fmi2Instantiate("a", fmi2CoSimulation, "{}", "", &functions, 0, 0) == NULL);
    assert(fmi2Instantiate("a", fmi2CoSimulation, MODEL_GUID, "", NULL, 0, 0) == NULL);
    c = fmi2Instantiate("a", fmi2CoSimulation, MODEL_GUID, "file:///%C3%A9 x/", &functions, 0, 1);
    assert(c != NULL);
    while (b->at < b->end) {
        Instance *in = c;
        fmi2Status status = fmi2OK;
        fmi2ValueReference vr[2];
        fmi2Real real[2] = {0, 0};
        int whole[2] = {0, 0};
        const char *string[2] = {NULL, NULL};
        unsigned n = pick(b, 3), k, action = pick(b, 34);
        fmi2FMUstate *s = &state[pick(b, STATES)];
        size_t size = 0;
        for (k = 0; k < 2; k++) {
            vr[k] = pick(b, 8) == 0 ? 0xFFFFFFFFu : pick(b, N_VALUES + 2);
            real[k] = odd_number(b, &VARIABLE[vr[k] < N_VALUES ? vr[k] : 0]);
            whole[k] = (int)pick(b, 5) - 2;
        }
        before = in->now;
        allocated = allocations;
        switch (action) {
        case 0: status = fmi2SetupExperiment(c, 0, 0, real[0], pick(b, 2), real[1]); break;
        case 1: case 2: status = fmi2EnterInitializationMode(c); break;
        case 3: case 4: status = fmi2ExitInitializationMode(c); break;
        case 5: if (pick(b, 8) == 0) status = fmi2Terminate(c); break;
        case 6: if (pick(b, 4) == 0) status = fmi2Reset(c); break;
        case 7: status = fmi2SetDebugLogging(c, 1, 0, NULL); break;
        case 8: status = fmi2GetReal(c, vr, n, n && pick(b, 9) == 0 ? NULL : real); break;
        case 9: status = fmi2GetInteger(c, vr, n, whole); break;
        case 10: status = fmi2GetBoolean(c, vr, n, whole); break;
        case 11: status = fmi2GetString(c, vr, n, string); break;
        case 12: case 13: status = fmi2SetReal(c, pick(b, 9) ? vr : NULL, n, real); break;
        case 14: status = fmi2SetInteger(c, vr, n, whole); break;
        case 15: status = fmi2SetBoolean(c, vr, n, whole); break;
        case 16: status = fmi2SetString(c, vr, n, string); break;
        case 17:
            /* Steps of many samples are legal, and slow. */
            if (real[0] > 10 * MODEL_PERIOD && real[0] < 2e6 * MODEL_PERIOD) break;
            status = fmi2DoStep(c, in->now.time, real[0], 1);
            break;
        case 18: status = fmi2DoStep(c, real[0], MODEL_PERIOD, 1); break;
        case 19: case 20: case 21: case 22:
            status = fmi2DoStep(c, in->now.time, MODEL_PERIOD * (1 + pick(b, 4)) / 2, pick(b, 2));
            break;
        case 23: status = fmi2GetFMUstate(c, s); break;
        case 24: if (*s != NULL) status = fmi2SetFMUstate(c, *s); break;
        case 25: status = fmi2FreeFMUstate(c, s); break;
        case 26: status = fmi2GetFMUstate(c, NULL); break;
        case 27: status = fmi2SetFMUstate(c, NULL); break;
        case 28: {
            /* Through bytes, now and then with a bit flipped. */
            fmi2Byte *blob;
            int flip = (int)pick(b, 3) == 0;
            if (*s == NULL || fmi2SerializedFMUstateSize(c, *s, &size) != fmi2OK) break;
            blob = malloc(size);
            assert(fmi2SerializeFMUstate(c, *s, blob, size) == fmi2OK);
            if (flip) blob[pick(b, (unsigned)size)] ^= (fmi2Byte)(1 << pick(b, 8));
            status = fmi2DeSerializeFMUstate(c, blob, flip && pick(b, 4) == 0 ? size - 1 : size, s);
            assert(flip ? status == fmi2Error : status == fmi2OK);
            free(blob);
            break;
        }
        case 29: status = fmi2CancelStep(c); break;
        case 30: status = fmi2GetRealStatus(c, (fmi2StatusKind)pick(b, 4), real); break;
        case 31: status = fmi2GetBooleanStatus(c, (fmi2StatusKind)pick(b, 4), whole); break;
        case 32:
            status = fmi2GetDirectionalDerivative(c, vr, n, vr + 1, n ? 1 : 0, real, real + 1);
            break;
        default: {
            fmi2Status unused;
            fmi2GetStatus(c, fmi2DoStepStatus, &unused);
            fmi2GetIntegerStatus(c, fmi2DoStepStatus, whole);
            fmi2GetStringStatus(c, fmi2PendingStatus, string);
            fmi2SetRealInputDerivatives(c, vr, n, whole, real);
            status = fmi2GetRealOutputDerivatives(c, vr, n, whole, real);
        }
        }
        assert(status == fmi2OK || status == fmi2Discard || status == fmi2Error);
        if (status == fmi2OK && action >= 17 && action <= 22) steps++;
        /* Reading in initialisation mode may compute what is asked for; a failed model stands still;
         * nothing else may change anything when it refuses. */
        if (status != fmi2OK && in->now.mode != FAILED && before.mode != INITIALIZATION &&
            action != 32) {
            assert(same(&before, &in->now));
        }
        if (action >= 8 && action <= 22) assert(allocations == allocated);
        check_finite(in);
    }
    {
        int i;
        for (i = 0; i < STATES; i++) fmi2FreeFMUstate(c, &state[i]);
    }
    fmi2FreeInstance(c);
    fmi2FreeInstance(NULL);
}

/* ---- Threads --------------------------------------------------------------------------------- */

#define INSTANCES 100
#define THREADS 8
#define SAMPLES 60

static void simulate(int which, Memory *result) {
    fmi2CallbackFunctions functions = {listen, NULL, NULL, NULL, NULL};
    fmi2Component c =
        fmi2Instantiate("a", fmi2CoSimulation, MODEL_GUID, "", &functions, 0, 0);
    int k;
    assert(c != NULL);
    fmi2SetupExperiment(c, 0, 0, 0, 0, 0);
    fmi2EnterInitializationMode(c);
    fmi2ExitInitializationMode(c);
    for (k = 0; k < SAMPLES; k++) {
        int i;
        for (i = AT_U; i < AT_Y; i++) {
            const Variable *v = &VARIABLE[i];
            fmi2ValueReference vr = (fmi2ValueReference)i;
            double value = v->start + 1e-5 * ((which * 7 + k * 3 + i) % 11);
            if (v->type == REAL && value >= v->min && value <= v->max) {
                fmi2SetReal(c, &vr, 1, &value);
            }
        }
        assert(fmi2DoStep(c, k * MODEL_PERIOD, MODEL_PERIOD, 1) == fmi2OK);
    }
    *result = ((Instance *)c)->now;
    fmi2FreeInstance(c);
}

static Memory parallel[INSTANCES];

static void *work(void *first) {
    int i;
    for (i = *(int *)first; i < INSTANCES; i += THREADS) simulate(i, &parallel[i]);
    return NULL;
}

static void threads(void) {
    static Memory serial;
    pthread_t thread[THREADS];
    int first[THREADS], i;
    for (i = 0; i < THREADS; i++) {
        first[i] = i;
        pthread_create(&thread[i], NULL, work, &first[i]);
    }
    for (i = 0; i < THREADS; i++) pthread_join(thread[i], NULL);
    for (i = 0; i < INSTANCES; i++) {
        simulate(i, &serial);
        assert(same(&serial, &parallel[i]));
    }
}

#if defined(FUZZER)
int LLVMFuzzerTestOneInput(const unsigned char *data, size_t size) {
    Bytes b = {data, data + size};
    walk(&b);
    return 0;
}
#else
int main(int argc, char **argv) {
    static unsigned char data[6000];
    if (argc == 2 && strcmp(argv[1], "threads") == 0) {
        threads();
    } else if (argc == 3 && strcmp(argv[1], "walk") == 0) {
        int seed;
        for (seed = 0; seed < atoi(argv[2]); seed++) {
            Bytes b = {data, data + sizeof data};
            size_t i;
            srand((unsigned)seed);
            for (i = 0; i < sizeof data; i++) data[i] = (unsigned char)(rand() >> 4);
            walk(&b);
        }
    } else {
        fprintf(stderr, "usage: hostile walk SEEDS | threads\n");
        return 2;
    }
    printf("%ld messages, %ld steps, %ld allocations\n", messages, steps, allocations);
    return 0;
}
#endif
