/* Faults that an emulated board shows on demand, drawn from a seed. No part of a firmware.
 *
 *     KIND[/ID][:RATE][@START-END]
 *
 * ID is the identifier that a fault of frames is for, of all frames if left out. START and END are
 * in seconds of board time: the sample counter in milliseconds. Without them the fault lasts from
 * sample 0 to the end. RATE is a probability:
 *
 *   of a frame      that it meets each frame; 1 if left out
 *   of a sample     that it meets each sample; 1 if left out
 *   of a time       that it begins in each millisecond and then lasts FAULT_EPISODE_MS; if left
 *                   out it lasts as long as START and END say. Babbling is drawn anew each
 *                   millisecond.
 */
#ifndef FAULTS_H
#define FAULTS_H

#include "board.h"

/* The one list of kinds: name in C, name in the option, of what, meaning. */
#define FAULT_KINDS(X)                                                                         \
    X(DROP, "drop", FRAMES, "frame is not sent")                                               \
    X(DELAY, "delay", FRAMES, "frame is sent 1 to 5 ms late")                                 \
    X(DUPLICATE, "duplicate", FRAMES, "frame is sent twice")                                   \
    X(REORDER, "reorder", FRAMES, "frame is sent after the one that follows it")               \
    X(CORRUPT, "corrupt", FRAMES, "one bit of the data is turned")                             \
    X(FREEZE, "freeze", SAMPLES, "sample has the data of the one before, the counter goes on") \
    X(STICK, "stick", FRAMES, "last frame of this id is sent again, counter and all")          \
    X(WRONG_LENGTH, "wrong-length", FRAMES, "frame has another length")                        \
    X(UNKNOWN, "unknown", FRAMES, "frame with a foreign id is sent before it")                 \
    X(BABBLE, "babble", TIMES, "frames with foreign ids fill the bus")                         \
    X(SILENCE, "silence", TIMES, "nothing is sent")                                            \
    X(BUS_OFF, "bus-off", TIMES, "nothing is sent, heard or acknowledged; status flags say so") \
    X(UNPLUG, "unplug", TIMES, "line and link are gone, and come back anew")                   \
    X(UNAVAILABLE, "unavailable", SAMPLES, "one channel, drawn once, is not available")

#define FAULT_EPISODE_MS 200
#define FAULT_MOST 32          /* faults at a time */
#define FAULT_LATE 256         /* frames that are on their way */
#define FAULT_BUS_FRAMES 8     /* frames of 8 bytes that a millisecond at 1 Mbit/s holds */
#define FAULT_IDS 16           /* ids of which the last frame is kept */
/* Frames that may leave in one millisecond. */
#define FAULT_FRAMES (FAULT_LATE + BOARD_FRAMES * (3 + FAULT_MOST) + FAULT_BUS_FRAMES)

#define FAULT_ENUM(name, text, of, meaning) FAULT_##name,
typedef enum { FAULT_KINDS(FAULT_ENUM) FAULT_KIND_COUNT } FaultKind;

typedef struct {
    FaultKind kind;
    bool one_id, rated;
    uint32_t id;
    double rate;
    uint32_t begin, end; /* board time [ms], end not included */
    uint64_t random;     /* each has a generator of its own, so that one does not change another */
    uint32_t until;      /* of an episode [ms] */
    bool on;             /* in this millisecond */
    int channel;
} Fault;

typedef struct {
    Fault fault[FAULT_MOST];
    int count;
    bool met[FAULT_KIND_COUNT]; /* kinds that are on in this millisecond */
    Sample before;
    bool has_before;
    Frame last[FAULT_IDS];
    int lasts;
    Frame held;
    bool holds;
    struct {
        Frame frame;
        uint32_t due;
    } late[FAULT_LATE];
    int lates;
} Faults;

/* Reads a fault as it stands in the option and adds it. Returns NULL, or what is wrong. */
const char *faults_add(Faults *x, const char *text);

/* Seeds all that have been added. */
void faults_seed(Faults *x, uint64_t seed);

/* Draws what is on at this board time [ms]; once each millisecond, before the others. */
void faults_begin(Faults *x, uint32_t ms);

/* What becomes of a sample on its way from the converter to the bus. */
Sample faults_sample(Faults *x, const Sample *sample);

/* What becomes of the frames of this millisecond. Returns how many are in `out`. */
int faults_frames(Faults *x, uint32_t ms, const Frame *in, int n, Frame out[FAULT_FRAMES]);

const char *fault_name(FaultKind kind);
const char *fault_meaning(FaultKind kind);

#endif
