/* A small host for any platform: loads an FMU's library, restores a state before every step, makes
 * one step, and writes all real values. `host LIBRARY CASE RESULT`; both files are little-endian.
 *
 *   case:   int32 inputs, values, steps, bytes of a state; char guid[64]; double period;
 *           uint32 references of the inputs, of the values; then for each step
 *           state, double time, double inputs
 *   result: for each step double values
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#include <windows.h>
#define OPEN(path) ((void *)LoadLibraryA(path))
#define FIND(library, name) ((void *)GetProcAddress((HMODULE)library, name))
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW)
#define FIND(library, name) dlsym(library, name)
#endif

typedef struct {
    void *logger, *allocate, *free, *finished, *environment;
} Callbacks;

typedef void *(*Instantiate)(
    const char *, int, const char *, const char *, const Callbacks *, int, int);
typedef int (*Call)(void *);
typedef int (*Setup)(void *, int, double, double, int, double);
typedef int (*Restore)(void *, const char *, size_t, void **);
typedef int (*SetState)(void *, void *);
typedef int (*SetReal)(void *, const unsigned *, size_t, const double *);
typedef int (*GetReal)(void *, const unsigned *, size_t, double *);
typedef int (*DoStep)(void *, double, double, int);

static void check(int bad, const char *what) {
    if (bad) {
        fprintf(stderr, "%s failed\n", what);
        exit(1);
    }
}

static void *take(FILE *file, size_t size) {
    void *data = malloc(size + 1);
    check(data == NULL || fread(data, 1, size, file) != size, "reading the case");
    return data;
}

int main(int argc, char **argv) {
    static Callbacks callbacks;
    FILE *input, *output;
    void *library, *c, *state = NULL;
    int *sizes, k;
    char *guid;
    double *period, *values;
    unsigned *in, *out;
    check(argc != 4, "usage: host LIBRARY CASE RESULT");
    library = OPEN(argv[1]);
    check(library == NULL, "loading the library");
    input = fopen(argv[2], "rb");
    output = fopen(argv[3], "wb");
    check(input == NULL || output == NULL, "opening the files");
    sizes = take(input, 16);
    guid = take(input, 64);
    period = take(input, 8);
    in = take(input, 4 * (size_t)sizes[0]);
    out = take(input, 4 * (size_t)sizes[1]);
    values = malloc(8 * (size_t)sizes[1] + 8);
    c = ((Instantiate)FIND(library, "fmi2Instantiate"))("host", 1, guid, "", &callbacks, 0, 0);
    check(c == NULL, "fmi2Instantiate");
    check(((Setup)FIND(library, "fmi2SetupExperiment"))(c, 0, 0, 0, 0, 0), "fmi2SetupExperiment");
    check(((Call)FIND(library, "fmi2EnterInitializationMode"))(c), "fmi2EnterInitializationMode");
    check(((Call)FIND(library, "fmi2ExitInitializationMode"))(c), "fmi2ExitInitializationMode");
    for (k = 0; k < sizes[2]; k++) {
        char *blob = take(input, (size_t)sizes[3]);
        double *time = take(input, 8), *u = take(input, 8 * (size_t)sizes[0]);
        check(
            ((Restore)FIND(library, "fmi2DeSerializeFMUstate"))(c, blob, (size_t)sizes[3], &state),
            "fmi2DeSerializeFMUstate");
        check(((SetState)FIND(library, "fmi2SetFMUstate"))(c, state), "fmi2SetFMUstate");
        check(((SetReal)FIND(library, "fmi2SetReal"))(c, in, (size_t)sizes[0], u), "fmi2SetReal");
        check(((DoStep)FIND(library, "fmi2DoStep"))(c, *time, *period, 1), "fmi2DoStep");
        check(
            ((GetReal)FIND(library, "fmi2GetReal"))(c, out, (size_t)sizes[1], values),
            "fmi2GetReal");
        check(fwrite(values, 8, (size_t)sizes[1], output) != (size_t)sizes[1], "writing");
        free(blob);
        free(time);
        free(u);
    }
    check(fclose(output), "writing");
    return 0;
}
