/* The instrument's electronics as a node on the bus: protocol, protection, drive and schedule.
 *
 * Nothing here calls an operating system or allocates: a firmware takes board.c, slcan.c and the
 * generated bus.c as they are and calls, once each millisecond by its own clock,
 *
 *     board_hear    for each frame that has come since,
 *     board_tick    with the sample that is measured now; it gives the frames to send.
 *
 * bus.h is packing code made from the DBC file by cantools, attributes.h what else the DBC says
 * (timeouts, protection, ramp rate). Whether the bus is classic or FD shows in bus.h.
 */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "attributes.h"
#include "bus.h"

#ifdef BUS_SENSORS_FRAME_ID
#define BOARD_FD 1
#define BOARD_NOT_AVAILABLE BUS_SENSORS_VOLTS_A1X_NOT_AVAILABLE_CHOICE
#else
#define BOARD_FD 0
#define BOARD_NOT_AVAILABLE BUS_SENSORS_A_VOLTS_A1X_NOT_AVAILABLE_CHOICE
#endif

#define FRAME_BYTES 64
#define BOARD_FRAMES 8 /* at least as many as one tick gives */
#define BOARD_CHANNELS 9
#define BOARD_STACKS 3

typedef struct {
    uint32_t id;
    bool extended, remote, fd;
    uint8_t length; /* bytes; of a remote frame those asked for */
    uint8_t data[FRAME_BYTES];
} Frame;

/* Raw values, in the order a1x a1z a2y a2z a3x a3y mx my mz. */
typedef struct {
    uint16_t volts[BOARD_CHANNELS];
    bool field_new;
    int16_t temperature; /* raw value of BoardStatus */
} Sample;

/* What has gone wrong so far, by the names of the table of faults. Frames; timeout and heartbeat
 * are events. */
typedef struct {
    uint32_t crc, length, repeated, lost, sequence, range, timeout, heartbeat, unknown;
} Counts;

typedef struct {
    uint8_t state;   /* of this node, BUS_BOARD_HEARTBEAT_BOARD_STATE_..._CHOICE */
    uint32_t ms;     /* since power came on, or since sample 0 */
    uint32_t sample; /* number of the next one */
    uint8_t status_count, feedback_count;

    bool heard; /* a command ever */
    uint8_t counter, doubt;
    struct bus_piezo_command_t command; /* the last good one */
    uint32_t quiet;                     /* ticks since it came */

    uint8_t loop_state;
    uint32_t loop_quiet;

    uint8_t mode; /* what the drive does, as in the command */
    uint16_t applied[BOARD_STACKS];
    bool follows;
    int32_t offset[BOARD_STACKS]; /* of what is applied from what is commanded */
    Counts counts;
} Board;

/* Power comes on: no sample yet, stacks at rest. */
void board_start(Board *b);

/* A frame has come. Sampling begins when the loop's heartbeat says operational. */
void board_hear(Board *b, const Frame *frame);

/* A millisecond has passed. `sample` is what is measured now, of interest while the state is
 * operational. Returns the number of frames in `out`, to be sent in that order. */
int board_tick(Board *b, const Sample *sample, Frame out[BOARD_FRAMES]);

/* No more samples; the drive goes to rest. */
void board_stop(Board *b);

/* Whether all stacks are at 0 V. */
bool board_at_rest(const Board *b);

/* Whether a frame with this identifier belongs to the bus. */
bool board_knows(uint32_t id);

#endif
