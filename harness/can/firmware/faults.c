#include "faults.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define TEXT(x) #x
#define TEXT_OF(x) TEXT(x)

typedef enum { FRAMES, SAMPLES, TIMES } Of;

#define FAULT_ROW(name, text, of, meaning) {text, of, meaning},
static const struct {
    const char *name;
    Of of;
    const char *meaning;
} KINDS[] = {FAULT_KINDS(FAULT_ROW)};

const char *fault_name(FaultKind kind) { return KINDS[kind].name; }
const char *fault_meaning(FaultKind kind) { return KINDS[kind].meaning; }

/* ---- Random numbers: SplitMix64 (Steele, Lea, Flood, OOPSLA 2014) -------------------------- */

static uint64_t draw(Fault *f)
{
    uint64_t z = f->random += 0x9E3779B97F4A7C15u;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return z ^ z >> 31;
}

static uint32_t below(Fault *f, uint32_t n) { return (uint32_t)((draw(f) >> 32) * n >> 32); }

static bool happens(Fault *f) { return (double)(draw(f) >> 11) * 0x1p-53 < f->rate; }

void faults_seed(Faults *x, uint64_t seed)
{
    for (int i = 0; i < x->count; i++) {
        Fault *f = &x->fault[i];
        f->random = seed;
        f->random = draw(f) + (uint64_t)i;
        f->channel = (int)below(f, BOARD_CHANNELS);
    }
}

/* ---- The option ---------------------------------------------------------------------------- */

/* Reads seconds as board time in ms. */
static bool time_of(const char **at, uint32_t *ms)
{
    char *end;
    if (**at < '0' || **at > '9') return false;
    double value = strtod(*at, &end);
    if (end == *at || !(value >= 0 && value <= 4e6)) return false;
    *ms = (uint32_t)lround(value * 1e3);
    *at = end;
    return true;
}

const char *faults_add(Faults *x, const char *text)
{
    char *end;
    if (x->count == FAULT_MOST) return "there are too many faults, more than " TEXT_OF(FAULT_MOST);
    Fault f = {.rate = 1.0, .end = UINT32_MAX};
    size_t size = strcspn(text, "/:@");
    int kind = 0;
    while (kind < FAULT_KIND_COUNT &&
           (strlen(KINDS[kind].name) != size || strncmp(KINDS[kind].name, text, size) != 0))
        kind++;
    if (kind == FAULT_KIND_COUNT) return "the kind is not known; --kinds lists them";
    f.kind = (FaultKind)kind;
    text += size;
    if (*text == '/') {
        unsigned long id = strtoul(text + 1, &end, 0);
        if (KINDS[kind].of != FRAMES) return "only faults of frames have an id";
        if (end == text + 1 || text[1] == '-' || !board_knows((uint32_t)id) || id > 0x7FF)
            return "the id is none of this bus; write it as 0x110";
        f.one_id = true;
        f.id = (uint32_t)id;
        text = end;
    }
    if (*text == ':') {
        f.rate = strtod(text + 1, &end);
        if (end == text + 1 || !(f.rate >= 0 && f.rate <= 1))
            return "the rate must be a probability, 0 to 1";
        f.rated = true;
        text = end;
    }
    if (*text == '@') {
        text++;
        if (!time_of(&text, &f.begin) || *text++ != '-' ||
            (*text != '\0' && !time_of(&text, &f.end)))
            return "the time must be START-END or START- in seconds of board time";
        if (f.end <= f.begin) return "the time must end after it begins";
    }
    if (*text != '\0') return "it is not of the form KIND[/ID][:RATE][@START-END]";
    x->fault[x->count++] = f;
    return NULL;
}

/* ---- What is on ---------------------------------------------------------------------------- */

static bool lasts(Fault *f, uint32_t ms)
{
    if (f->kind == FAULT_BABBLE) return happens(f);
    if (!f->rated) return true;
    if (ms < f->until) return true;
    if (!happens(f)) return false;
    f->until = ms + FAULT_EPISODE_MS;
    return true;
}

void faults_begin(Faults *x, uint32_t ms)
{
    memset(x->met, 0, sizeof x->met);
    for (int i = 0; i < x->count; i++) {
        Fault *f = &x->fault[i];
        f->on = ms >= f->begin && ms < f->end;
        if (!f->on) continue;
        if (KINDS[f->kind].of == SAMPLES) f->on = happens(f);
        if (KINDS[f->kind].of == TIMES) f->on = lasts(f, ms);
        x->met[f->kind] |= f->on;
    }
}

Sample faults_sample(Faults *x, const Sample *sample)
{
    Sample s = x->met[FAULT_FREEZE] && x->has_before ? x->before : *sample;
    x->before = s;
    x->has_before = true;
    for (int i = 0; i < x->count; i++)
        if (x->fault[i].on && x->fault[i].kind == FAULT_UNAVAILABLE)
            s.volts[x->fault[i].channel] = BOARD_NOT_AVAILABLE;
    return s;
}

/* ---- Frames -------------------------------------------------------------------------------- */

static Frame foreign(Fault *f)
{
    Frame frame = {.length = 8};
    do frame.id = below(f, 0x800);
    while (board_knows(frame.id));
    for (int i = 0; i < frame.length; i++) frame.data[i] = (uint8_t)below(f, 256);
    return frame;
}

static void lengthen(Fault *f, Frame *frame)
{
    static const uint8_t lengths[] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};
    const uint32_t n = frame->fd ? 16 : 9;
    uint8_t length;
    do length = lengths[below(f, n)];
    while (length == frame->length);
    frame->length = length;
}

/* The place for the last frame of this id; NULL when there are too many ids. */
static Frame *last_of(Faults *x, uint32_t id, bool *is_new)
{
    int i = 0;
    while (i < x->lasts && x->last[i].id != id) i++;
    *is_new = i == x->lasts;
    if (i == FAULT_IDS) return NULL;
    if (*is_new) x->lasts++;
    return &x->last[i];
}

static int emit(Faults *x, const Frame *frame, Frame *out, int n)
{
    out[n++] = *frame;
    if (x->holds) {
        out[n++] = x->held;
        x->holds = false;
    }
    return n;
}

static int pass(Faults *x, uint32_t ms, Frame frame, Frame *out, int n)
{
    int copies = 1;
    uint32_t late = 0;
    bool hold = false, is_new;
    Frame *last = last_of(x, frame.id, &is_new);
    if (last && is_new) *last = frame;

    for (int i = 0; i < x->count; i++) {
        Fault *f = &x->fault[i];
        if (!f->on || KINDS[f->kind].of != FRAMES) continue;
        if ((f->one_id && f->id != frame.id) || !happens(f)) continue;
        if (f->kind == FAULT_DROP) copies = 0;
        if (f->kind == FAULT_DELAY) late = 1 + below(f, 5);
        if (f->kind == FAULT_DUPLICATE && copies) copies = 2;
        if (f->kind == FAULT_REORDER) hold = true;
        if (f->kind == FAULT_STICK && last) frame = *last;
        if (f->kind == FAULT_WRONG_LENGTH) lengthen(f, &frame);
        if (f->kind == FAULT_CORRUPT && frame.length) {
            uint32_t bit = below(f, 8u * frame.length);
            frame.data[bit / 8] ^= (uint8_t)(1u << bit % 8);
        }
        if (f->kind == FAULT_UNKNOWN) {
            Frame extra = foreign(f);
            n = emit(x, &extra, out, n);
        }
    }
    if (last && copies) *last = frame;
    if (!copies) return n;
    if (late && x->lates < FAULT_LATE) {
        x->late[x->lates].frame = frame;
        x->late[x->lates++].due = ms + late;
    } else if (hold && !x->holds) {
        x->held = frame;
        x->holds = true;
    } else {
        for (int i = 0; i < copies; i++) n = emit(x, &frame, out, n);
    }
    return n;
}

int faults_frames(Faults *x, uint32_t ms, const Frame *in, int n_in, Frame out[FAULT_FRAMES])
{
    int n = 0, kept = 0;
    for (int i = 0; i < n_in; i++) n = pass(x, ms, in[i], out, n);
    for (int i = 0; i < x->lates; i++) {
        if (x->late[i].due <= ms)
            n = emit(x, &x->late[i].frame, out, n);
        else
            x->late[kept++] = x->late[i];
    }
    x->lates = kept;
    for (int i = 0; i < x->count; i++) {
        Fault *f = &x->fault[i];
        if (!f->on || f->kind != FAULT_BABBLE) continue;
        while (n < FAULT_BUS_FRAMES) {
            Frame extra = foreign(f);
            n = emit(x, &extra, out, n);
        }
    }
    return x->met[FAULT_SILENCE] ? 0 : n;
}
