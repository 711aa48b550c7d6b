/* Many ticks of the loop in one call; `native.py` lays out the plan, and mirrors these structures.
 *
 * Needs no C library, so that it compiles in a moment wherever the compiler is.
 */
#include <float.h>
#include <stdint.h>

#include "access.h"

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
int DllMainCRTStartup(void *library, unsigned reason, void *reserved) { return 1; }
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum { WARNING = 1 }; /* the last of FMI's statuses that one may go on with */
/* why it came back: the room for records is full, the run is over, or something is wrong */
enum { FULL, DONE, STOPPED, FAILED, NOT_FINITE, LATE };

struct part {
    size_t inputs; /* u[i] is history[sources[i]] */
    const intptr_t *sources;
    double *u;
    size_t outputs;
    double *y;
    double limit; /* that a step may take [s] */
    /* an FMU */
    int (*do_step)(void *component, double t, double h, int never_returns);
    void *component;
    int never_returns;
    size_t setters, getters;
    const struct access *set, *get;
    /* or, without do_step, a table: a row of outputs for each tick, of which the last one stays */
    const double *table;
    int64_t rows;
};

struct loop {
    size_t count;
    struct part *parts;
    double *history; /* outputs of all parts: of this tick, of the one before, ... */
    size_t width, length;
    double step;
    int64_t tick, last;
    double *row;  /* where this tick goes, and how many have room from there on */
    int64_t room;
    void (*clock)(void); /* clock_gettime; or QueryPerformanceCounter */
    int clock_id;
    double clock_period; /* of QueryPerformanceCounter [s] */
    volatile int64_t begun; /* calls of parts that have begun; for the watching thread */
    volatile int stop;      /* from it */
    int64_t part, call, status; /* what failed: its index; the call: setters, step, getters */
    double took;                /* a step that was late [s] */
};

/* Size and offset of the last field, which `native.py` compares with its own. */
#define LAYOUT(name, last) {sizeof(struct name), offsetof(struct name, last)}
EXPORT const size_t access_layout[2] = LAYOUT(access, integers);
EXPORT const size_t part_layout[2] = LAYOUT(part, rows);
EXPORT const size_t loop_layout[2] = LAYOUT(loop, took);

static double now(const struct loop *m) {
    int64_t time[2];
#ifdef _WIN32
    ((int (*)(int64_t *))m->clock)(time);
    return (double)time[0] * m->clock_period;
#else
    ((int (*)(int, int64_t *))m->clock)(m->clock_id, time);
    return (double)time[0] + 1e-9 * (double)time[1];
#endif
}

static int fails(struct loop *m, int64_t call, int status) {
    m->call = call;
    m->status = status;
    return status > WARNING;
}

static int advance(struct loop *m, const struct part *p, double t) {
    int64_t call = 0;
    for (const struct access *a = p->set; a < p->set + p->setters; ++a) {
        if (a->integers)
            for (size_t i = 0; i < a->count; ++i) a->integers[i] = (int)a->values[i];
        void *values = a->integers ? (void *)a->integers : a->values;
        if (fails(m, call++, a->call(p->component, a->references, a->count, values))) return 0;
    }
    if (fails(m, call++, p->do_step(p->component, t, m->step, p->never_returns))) return 0;
    for (const struct access *a = p->get; a < p->get + p->getters; ++a) {
        void *values = a->integers ? (void *)a->integers : a->values;
        if (fails(m, call++, a->call(p->component, a->references, a->count, values))) return 0;
        if (a->integers)
            for (size_t i = 0; i < a->count; ++i) a->values[i] = a->integers[i];
    }
    return 1;
}

static int tick(struct loop *m, double *since) {
    double t = (double)m->tick * m->step;
    for (size_t k = 0; k < m->count; ++k) {
        const struct part *p = m->parts + k;
        m->part = (int64_t)k;
        m->begun = m->tick * (int64_t)m->count + m->part + 1;
        for (size_t i = 0; i < p->inputs; ++i) p->u[i] = m->history[p->sources[i]];
        if (p->do_step) {
            if (!advance(m, p, t)) return FAILED;
        } else {
            int64_t row = m->tick < p->rows ? m->tick : p->rows - 1;
            const double *values = p->table + row * (int64_t)p->outputs;
            for (size_t i = 0; i < p->outputs; ++i) p->y[i] = values[i];
        }
        int finite = 1;
        for (size_t i = 0; i < p->outputs; ++i)
            finite &= p->y[i] >= -DBL_MAX && p->y[i] <= DBL_MAX;
        if (!finite) return NOT_FINITE;
        double then = now(m);
        m->took = then - *since;
        if (m->took > p->limit) return LATE;
        *since = then;
    }
    return DONE;
}

EXPORT int run_ticks(struct loop *m) {
    double since = now(m);
    size_t older = m->length - m->width;
    while (m->tick < m->last) {
        int how = tick(m, &since);
        if (how != DONE) return how;
        for (size_t i = 0; i < m->width; ++i) m->row[i] = m->history[i];
        m->row += m->width;
        /* From the end: a value is read before the one of a tick ago comes to its place. */
        for (size_t i = older; i > 0; --i) m->history[i + m->width - 1] = m->history[i - 1];
        ++m->tick;
        --m->room;
        if (m->stop) return STOPPED;
        if (!m->room && m->tick < m->last) return FULL;
    }
    return DONE;
}
