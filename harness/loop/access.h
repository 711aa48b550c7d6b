/* One call of a tick that passes values of one type: fmi2SetReal and its kin; `native.py` mirrors it. */
#include <stddef.h>

struct access {
    int (*call)(void *component, const unsigned *references, size_t count, void *values);
    const unsigned *references;
    size_t count;
    double *values; /* doubles whatever the type */
    int *integers;  /* what Integer and Boolean pass through; NULL for Real */
};
