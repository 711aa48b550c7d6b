/* slcan, the ASCII protocol of LAWICEL's CAN232 that most CAN adapters on a serial line speak.
 *
 * Each line ends with CR. From the host: Sn, sxxyy, Yn (bit rates), O, L, C (open, listen, close),
 * Z0, Z1 (whether frames end in four digits of milliseconds), V, N (version, serial number), F
 * (status), and frames: t, r (11 bit), T, R (29 bit), data and remote; d, b, D, B are CAN FD frames
 * without and with the bit rate switched. The answer is CR, or the value asked for and CR, z or Z
 * and CR for a frame, BEL for what is refused. On its own the adapter tells bus-off (sb) and its end
 * (sa), with both error counters, as the Linux driver for slcan understands it.
 */
#ifndef SLCAN_H
#define SLCAN_H

#include <stddef.h>

#include "board.h"

#define SLCAN_LINE (1 + 8 + 1 + 2 * FRAME_BYTES + 4 + 1) /* longest one, with its CR */

/* Status flags of the answer to F. */
#define SLCAN_WARNING 0x04
#define SLCAN_OVERRUN 0x08
#define SLCAN_PASSIVE 0x20
#define SLCAN_BUS_ERROR 0x80

typedef struct {
    bool open, listen, stamps;
    bool bus_off;  /* frames are neither sent nor taken; set by slcan_bus */
    bool told_off; /* the host knows of it */
    uint8_t flags; /* until they are asked for */
    char line[SLCAN_LINE];
    size_t filled; /* more than fits: the line is skipped */
} Slcan;

typedef void SlcanHear(void *context, const Frame *frame);
typedef void SlcanReply(void *context, const char *text, size_t size);

/* Takes what has come from the host, in pieces of any size. */
void slcan_take(Slcan *s, const char *text, size_t size, SlcanHear *hear, SlcanReply *reply,
                void *context);

/* Writes a frame to `text`, which has room for SLCAN_LINE; returns the number of characters.
 * `ms` is the time for the stamp. */
size_t slcan_write(const Slcan *s, const Frame *frame, uint32_t ms, char *text);

/* Says whether the controller is off the bus; a change is told to the host. */
void slcan_bus(Slcan *s, bool is_off, SlcanReply *reply, void *context);

#endif
