#include "board.h"

#include <string.h>

#define MOST_LOST 2 /* frames in a row that may be missing without a fault */
#define TO_SYNC 2   /* good frames that end a wrong sequence */

#define OFF BUS_PIEZO_COMMAND_MODE_OFF_CHOICE
#define OPERATIONAL BUS_BOARD_HEARTBEAT_BOARD_STATE_OPERATIONAL_CHOICE
#define PRE_OPERATIONAL BUS_BOARD_HEARTBEAT_BOARD_STATE_PRE_OPERATIONAL_CHOICE
#define STOPPED BUS_BOARD_HEARTBEAT_BOARD_STATE_STOPPED_CHOICE
#define LOOP_OPERATIONAL BUS_LOOP_HEARTBEAT_LOOP_STATE_OPERATIONAL_CHOICE

/* ---- End-to-end protection, AUTOSAR profiles 1 and 5 (0: none) ----------------------------- */

static unsigned modulus(int profile) { return profile == 5 ? 256 : 15; }

static unsigned crc8(unsigned crc, unsigned byte)
{
    crc ^= byte;
    for (int bit = 0; bit < 8; bit++) crc = (crc << 1 ^ (crc & 0x80 ? 0x1D : 0)) & 0xFF;
    return crc;
}

static unsigned crc16(unsigned crc, unsigned byte)
{
    crc ^= byte << 8;
    for (int bit = 0; bit < 8; bit++) crc = (crc << 1 ^ (crc & 0x8000 ? 0x1021 : 0)) & 0xFFFF;
    return crc;
}

static unsigned crc_of(const Frame *f, int profile, unsigned data_id)
{
    unsigned crc = profile == 5 ? 0xFFFF : 0;
    if (profile == 5) {
        for (int i = 2; i < f->length; i++) crc = crc16(crc, f->data[i]);
        return crc16(crc16(crc, data_id & 0xFF), data_id >> 8);
    }
    crc = crc8(crc8(crc, data_id & 0xFF), data_id >> 8);
    for (int i = 1; i < f->length; i++) crc = crc8(crc, f->data[i]);
    return crc;
}

static void protect(Frame *f, int profile, unsigned data_id)
{
    if (profile == 0) return;
    unsigned crc = crc_of(f, profile, data_id);
    f->data[0] = (uint8_t)(crc & 0xFF);
    if (profile == 5) f->data[1] = (uint8_t)(crc >> 8);
}

static bool is_intact(const Frame *f, int profile, unsigned data_id)
{
    unsigned found = f->data[0] | (profile == 5 ? (unsigned)f->data[1] << 8 : 0);
    return profile == 0 || found == crc_of(f, profile, data_id);
}

/* What the counter of an intact frame says; whether the frame may be used. */
static bool in_sequence(Board *b, unsigned counter, unsigned n)
{
    unsigned step = (counter + n - b->counter % n) % n;
    bool first = !b->heard;
    if (!first && counter == b->counter) {
        b->counts.repeated++;
        return false;
    }
    b->heard = true;
    b->counter = (uint8_t)counter;
    if (first) return true;
    if (counter >= n || step > MOST_LOST + 1) {
        b->counts.sequence++;
        b->doubt = TO_SYNC;
        return false;
    }
    b->counts.lost += step - 1;
    if (b->doubt > 0) b->doubt--;
    return b->doubt == 0;
}

/* ---- What comes ---------------------------------------------------------------------------- */

static bool fits(Board *b, const Frame *f, unsigned length, bool fd)
{
    if (!f->remote && f->length == length && f->fd == fd) return true;
    b->counts.length++;
    return false;
}

static void hear_command(Board *b, const Frame *f)
{
    struct bus_piezo_command_t c;
    if (!fits(b, f, BUS_PIEZO_COMMAND_LENGTH, BUS_PIEZO_COMMAND_IS_FD)) return;
    if (!is_intact(f, BUS_PIEZO_COMMAND_PROFILE, BUS_PIEZO_COMMAND_DATA_ID)) {
        b->counts.crc++;
        return;
    }
    bus_piezo_command_unpack(&c, f->data, f->length);
    if (!in_sequence(b, c.counter, modulus(BUS_PIEZO_COMMAND_PROFILE))) return;
    if (!bus_piezo_command_mode_is_in_range(c.mode) ||
        (c.mode != OFF && !(bus_piezo_command_volts_1_is_in_range(c.volts_1) &&
                            bus_piezo_command_volts_2_is_in_range(c.volts_2) &&
                            bus_piezo_command_volts_3_is_in_range(c.volts_3)))) {
        b->counts.range++;
        return;
    }
    b->command = c;
    b->quiet = 0;
}

static void hear_heartbeat(Board *b, const Frame *f)
{
    if (!fits(b, f, BUS_LOOP_HEARTBEAT_LENGTH, BUS_LOOP_HEARTBEAT_IS_FD)) return;
    b->loop_state = f->data[0];
    b->loop_quiet = 0;
    if (b->state == PRE_OPERATIONAL && b->loop_state == LOOP_OPERATIONAL) {
        b->state = OPERATIONAL;
        b->ms = 0;
    }
}

void board_hear(Board *b, const Frame *f)
{
    if (!f->extended && f->id == BUS_PIEZO_COMMAND_FRAME_ID)
        hear_command(b, f);
    else if (!f->extended && f->id == BUS_LOOP_HEARTBEAT_FRAME_ID)
        hear_heartbeat(b, f);
    else
        b->counts.unknown++;
}

/* ---- The drive ----------------------------------------------------------------------------- */

/* Voltages never jump, neither into rest nor out of it:
 *
 *     o <- o - clip(o, -R, R),   v = clip(u + o, v_min, v_max)     following
 *     v <- v + clip(-v, -R, R)                                     on the way to rest
 *
 * When following begins, o = v - u: the voltages go on from where they are, and the difference
 * fades at the ramp rate R while they follow, however fast that is. */

static int32_t clip(int32_t x, int32_t low, int32_t high)
{
    return x < low ? low : x > high ? high : x;
}

static int32_t toward(int32_t gap)
{
    return clip(gap, -BUS_RAMP_COUNTS_PER_MS, BUS_RAMP_COUNTS_PER_MS);
}

static void drive(Board *b)
{
    /* A loop that has never been heard is not lost, it is not there yet. */
    if (b->heard && b->quiet == BUS_PIEZO_COMMAND_TIMEOUT_MS) {
        b->counts.timeout++;
        b->doubt = TO_SYNC;
    }
    if (b->loop_quiet == BUS_LOOP_HEARTBEAT_TIMEOUT_MS) b->counts.heartbeat++;
    bool led = b->state == OPERATIONAL && b->loop_state == LOOP_OPERATIONAL &&
               b->loop_quiet < BUS_LOOP_HEARTBEAT_TIMEOUT_MS && b->heard &&
               b->quiet < BUS_PIEZO_COMMAND_TIMEOUT_MS;
    const uint16_t volts[] = {b->command.volts_1, b->command.volts_2, b->command.volts_3};

    b->mode = led ? b->command.mode : OFF;
    const bool follows = b->mode != OFF;
    for (int i = 0; i < BOARD_STACKS; i++) {
        int32_t v = b->applied[i];
        const int32_t u = volts[i];
        if (follows) {
            const int32_t o = b->follows ? b->offset[i] : v - u;
            const int32_t left = o - toward(o);
            v = clip(u + left, BUS_VOLTS_LOW, BUS_VOLTS_HIGH);
            b->offset[i] = left ? v - u : 0;
        } else {
            v += toward(-v);
        }
        b->applied[i] = (uint16_t)v;
    }
    b->follows = follows;
    /* Beyond their limits they have nothing more to say, and must not wrap round. */
    if (b->quiet <= BUS_PIEZO_COMMAND_TIMEOUT_MS) b->quiet++;
    if (b->loop_quiet <= BUS_LOOP_HEARTBEAT_TIMEOUT_MS) b->loop_quiet++;
}

bool board_at_rest(const Board *b)
{
    return b->applied[0] == 0 && b->applied[1] == 0 && b->applied[2] == 0;
}

/* ---- What goes ----------------------------------------------------------------------------- */

/* Adds a frame of the message whose name is MESSAGE in capitals and `message` in small letters. */
#define SEND(MESSAGE, message, ...)                                                         \
    do {                                                                                    \
        const struct bus_##message##_t packed = {__VA_ARGS__};                              \
        Frame *f = &out[n++];                                                               \
        memset(f, 0, sizeof *f);                                                            \
        f->id = BUS_##MESSAGE##_FRAME_ID;                                                   \
        f->fd = BUS_##MESSAGE##_IS_FD;                                                      \
        f->length = BUS_##MESSAGE##_LENGTH;                                                 \
        bus_##message##_pack(f->data, &packed, sizeof f->data);                             \
        protect(f, BUS_##MESSAGE##_PROFILE, BUS_##MESSAGE##_DATA_ID);                       \
    } while (0)

/* The counter of a message that does not count samples. */
static uint8_t next(uint8_t *count, int profile)
{
    uint8_t now = *count;
    *count = (uint8_t)((now + 1u) % modulus(profile));
    return now;
}

static int send_sample(const Board *b, const Sample *s, Frame *out)
{
    int n = 0;
    const uint16_t *v = s->volts;
#if BOARD_FD
    SEND(SENSORS, sensors, .counter = (uint8_t)(b->sample % modulus(BUS_SENSORS_PROFILE)),
         .field_new = s->field_new, .sample = b->sample, .board_time = b->sample * 1000u,
         .volts_a1x = v[0], .volts_a1z = v[1], .volts_a2y = v[2], .volts_a2z = v[3],
         .volts_a3x = v[4], .volts_a3y = v[5], .volts_mx = v[6], .volts_my = v[7],
         .volts_mz = v[8]);
#else
    const uint8_t counter = (uint8_t)(b->sample % modulus(BUS_SENSORS_A_PROFILE));
    SEND(SENSORS_A, sensors_a, .counter = counter, .volts_a1x = v[0], .volts_a1z = v[1],
         .volts_a2y = v[2]);
    SEND(SENSORS_B, sensors_b, .counter = counter, .volts_a2z = v[3], .volts_a3x = v[4],
         .volts_a3y = v[5]);
    SEND(SENSORS_M, sensors_m, .counter = counter, .field_new = s->field_new, .volts_mx = v[6],
         .volts_my = v[7], .volts_mz = v[8]);
#endif
    return n;
}

int board_tick(Board *b, const Sample *sample, Frame out[BOARD_FRAMES])
{
    int n = 0;
    drive(b);
    if (b->state == OPERATIONAL) {
        if (b->ms % BUS_BOARD_STATUS_CYCLE_TIME_MS == 0)
            SEND(BOARD_STATUS, board_status,
                 .counter = next(&b->status_count, BUS_BOARD_STATUS_PROFILE),
                 .sample = b->sample, .temperature = sample->temperature);
        n += send_sample(b, sample, out + n);
        b->sample++;
        if (b->ms % BUS_PIEZO_FEEDBACK_CYCLE_TIME_MS == 0)
            SEND(PIEZO_FEEDBACK, piezo_feedback,
                 .counter = next(&b->feedback_count, BUS_PIEZO_FEEDBACK_PROFILE),
                 .applied_mode = b->mode, .applied_1 = b->applied[0],
                 .applied_2 = b->applied[1], .applied_3 = b->applied[2]);
    }
    if (b->ms % BUS_BOARD_HEARTBEAT_CYCLE_TIME_MS == 0)
        SEND(BOARD_HEARTBEAT, board_heartbeat, .board_state = b->state);
    b->ms++;
    return n;
}

/* ---- Beginning and end --------------------------------------------------------------------- */

void board_start(Board *b)
{
    memset(b, 0, sizeof *b);
    b->state = PRE_OPERATIONAL;
    b->quiet = BUS_PIEZO_COMMAND_TIMEOUT_MS + 1;
    b->loop_quiet = BUS_LOOP_HEARTBEAT_TIMEOUT_MS + 1;
}

void board_stop(Board *b)
{
    b->state = STOPPED;
    b->ms = 0; /* so that the next heartbeat says so at once */
}

bool board_knows(uint32_t id)
{
    static const uint32_t known[] = BUS_FRAME_IDS;
    for (unsigned i = 0; i < sizeof known / sizeof *known; i++)
        if (known[i] == id) return true;
    return false;
}
