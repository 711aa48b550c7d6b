/* A host in C that steps one FMU and takes the time of every sample; `stepper.py` mirrors this.
 *
 * A sample is what any host calls in each: inputs set, a step, outputs got.
 */
#define _POSIX_C_SOURCE 199309L
#include <stdint.h>

#include "access.h"
#ifdef _WIN32
#include <windows.h>
#define EXPORT __declspec(dllexport)
static double now(void) {
    LARGE_INTEGER count, frequency;
    QueryPerformanceFrequency(&frequency);
    QueryPerformanceCounter(&count);
    return (double)count.QuadPart / (double)frequency.QuadPart;
}
#else
#include <time.h>
#define EXPORT __attribute__((visibility("default")))
static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
#endif

struct fmu {
    void *component;
    int (*do_step)(void *component, double t, double h, int never_returns);
    double step;
    size_t setters, getters;
    const struct access *set, *get;
    const double *inputs; /* a row for each sample */
    size_t width;
};

/* Size and offset of the last field, which `stepper.py` compares with its own. */
EXPORT const size_t fmu_layout[2] = {sizeof(struct fmu), offsetof(struct fmu, width)};

static int sample(const struct fmu *f, int64_t k) {
    double *row = (double *)f->inputs + (size_t)k * f->width;
    int worst = 0;
    for (const struct access *a = f->set; a < f->set + f->setters; row += a++->count) {
        if (a->integers)
            for (size_t i = 0; i < a->count; ++i) a->integers[i] = (int)row[i];
        void *values = a->integers ? (void *)a->integers : row;
        int status = a->call(f->component, a->references, a->count, values);
        if (status > worst) worst = status;
    }
    int status = f->do_step(f->component, (double)k * f->step, f->step, 1);
    if (status > worst) worst = status;
    for (const struct access *a = f->get; a < f->get + f->getters; ++a) {
        void *values = a->integers ? (void *)a->integers : a->values;
        status = a->call(f->component, a->references, a->count, values);
        if (status > worst) worst = status;
    }
    return worst;
}

/* Samples `first` to `last`; with the time of each where there is room for it in `spent` [s].
 * Gives the worst status. */
EXPORT int samples(const struct fmu *f, int64_t first, int64_t last, double *spent) {
    int worst = 0;
    double since = now();
    for (int64_t k = first; k < last; ++k) {
        int status = sample(f, k);
        if (status > worst) worst = status;
        if (spent) {
            double then = now();
            spent[k - first] = then - since;
            since = then;
        }
    }
    return worst;
}
