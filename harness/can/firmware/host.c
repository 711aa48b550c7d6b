/* The board as a process: slcan on a pseudo-terminal, a recording in the place of converters. */
#define _XOPEN_SOURCE 700

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "board.h"
#include "faults.h"
#include "slcan.h"

#define MS 1000000LL        /* ns */
#define LINGER_MS 1000      /* that a host has to read the rest after the last sample */
#define LINE_ROOM 1024      /* longest line of a recording */
#define UNSENT_ROOM 16384   /* characters that wait for a slow host */
#define ADC_SPAN 5.0        /* V; its last count is the one that says "not available" */
#if BOARD_FD
#define VOLTS_ENCODE bus_sensors_volts_a1x_encode
#else
#define VOLTS_ENCODE bus_sensors_a_volts_a1x_encode
#endif
#define OPERATIONAL BUS_BOARD_HEARTBEAT_BOARD_STATE_OPERATIONAL_CHOICE

static const char USAGE[] =
    "usage: board --link PATH --samples FILE [options]\n"
    "\n"
    "The electronics of the instrument as a CAN adapter with a board behind it: slcan on a\n"
    "pseudo-terminal. Sampling begins when the loop's heartbeat says operational.\n"
    "\n"
    "  --link PATH      symbolic link to make, to the terminal that the host opens\n"
    "  --samples FILE   recording at 1 kHz: CSV with a header that names the columns volts_a1x,\n"
    "                   volts_a1z, volts_a2y, volts_a2z, volts_a3x, volts_a3y, volts_mx, volts_my,\n"
    "                   volts_mz [V, nan: not available], and if wanted temperature [degC] and\n"
    "                   field_new [0 or 1]\n"
    "  --loop           play it again and again\n"
    "  --log FILE       write a CSV row per sample: voltages applied, mode, faults seen\n"
    "  --drift PPM      the board's clock runs fast by that much; negative: slow\n"
    "  --fault KIND[/ID][:RATE][@START-END]\n"
    "                   misbehave; may be repeated. ID: frames it is for; RATE: probability per\n"
    "                   frame, sample or ms; START, END: seconds since sample 0\n"
    "  --seed N         of the faults, 0 if left out\n"
    "  --priority N     run at this priority of SCHED_FIFO, 1 to 99, if the system lets it\n"
    "  --with-parent    end when the process that started this one has ended\n"
    "  --kinds          list the kinds of faults and end\n"
    "  --help           say this and end\n";

typedef struct {
    const char *link, *samples, *log;
    bool loop, with_parent;
    double drift;
    int priority; /* 0: an ordinary process */
    uint64_t seed;
} Options;

typedef struct {
    int fd; /* -1 while unplugged */
    char name[128];
    char out[UNSENT_ROOM];
    size_t waiting;
    unsigned long unsent; /* frames that found no room */
} Line;

typedef struct {
    Options options;
    Sample *samples;
    size_t count;
    Board board;
    Slcan slcan;
    Faults faults;
    Line line;
    FILE *log;
} Host;

static volatile sig_atomic_t told_to_end;

static void on_signal(int number)
{
    (void)number;
    told_to_end = 1;
}

static void fail(const char *what, const char *which, const char *why)
{
    fprintf(stderr, "board: %s '%s': %s\n", what, which, why);
    exit(2);
}

/* ---- Options ------------------------------------------------------------------------------- */

static double number_of(const char *option, const char *text, double low, double high)
{
    char *end, why[96];
    double value = strtod(text, &end);
    if (end == text || *end != '\0' || !(value >= low && value <= high)) {
        snprintf(why, sizeof why, "it must be a number in [%.0f, %.0f]", low, high);
        fail(option, text, why);
    }
    return value;
}

static Options options_of(int argc, char **argv, Faults *faults)
{
    Options o = {0};
    for (int i = 1; i < argc; i++) {
        const char *name = argv[i], *value = i + 1 < argc ? argv[i + 1] : NULL;
        if (strcmp(name, "--help") == 0) {
            fputs(USAGE, stdout);
            exit(0);
        }
        if (strcmp(name, "--kinds") == 0) {
            for (int k = 0; k < FAULT_KIND_COUNT; k++)
                printf("%s\t%s\n", fault_name((FaultKind)k), fault_meaning((FaultKind)k));
            exit(0);
        }
        if (strcmp(name, "--loop") == 0) {
            o.loop = true;
            continue;
        }
        if (strcmp(name, "--with-parent") == 0) {
            o.with_parent = true;
            continue;
        }
        static const char *const with_value[] = {"--link", "--samples", "--log",
                                                 "--drift", "--fault", "--seed",
                                                 "--priority"};
        const size_t count = sizeof with_value / sizeof *with_value;
        size_t known = 0;
        while (known < count && strcmp(name, with_value[known]) != 0) known++;
        if (known == count) fail("option", name, "it is not known; --help lists the options");
        if (!value) fail("option", name, "it needs a value");
        i++;
        const char *why = NULL;
        switch (known) {
        case 0: o.link = value; break;
        case 1: o.samples = value; break;
        case 2: o.log = value; break;
        case 3: o.drift = number_of(name, value, -10000, 10000); break;
        case 4: why = faults_add(faults, value); break;
        case 6: o.priority = (int)number_of(name, value, 1, 99); break;
        default: o.seed = (uint64_t)number_of(name, value, 0, 4294967295.0); break;
        }
        if (why) fail(name, value, why);
    }
    if (!o.link) fail("option", "--link", "it is missing; --help lists the options");
    if (!o.samples) fail("option", "--samples", "it is missing; --help lists the options");
    faults_seed(faults, o.seed);
    return o;
}

/* ---- The recording ------------------------------------------------------------------------- */

enum { TEMPERATURE = BOARD_CHANNELS, FIELD_NEW, COLUMNS };
static const char *const NAMES[COLUMNS] = {"volts_a1x", "volts_a1z", "volts_a2y", "volts_a2z",
                                           "volts_a3x", "volts_a3y", "volts_mx", "volts_my",
                                           "volts_mz", "temperature", "field_new"};

static const char *const RANGES[] = {"a voltage must be in [0, 5] V, or nan for not available, not",
                                     "a temperature must be in [-40, 125] degC, not",
                                     "field_new must be 0 or 1, not"};

static void bad_line(const char *file, size_t line, const char *what, const char *which)
{
    char why[160];
    snprintf(why, sizeof why, "line %zu: %s '%.40s'", line, what, which);
    fail("recording", file, why);
}

/* Splits a line at its commas, in place; returns the number of cells. */
static int cells_of(char *line, char **cells, int most)
{
    int n = 0;
    line[strcspn(line, "\r\n")] = '\0';
    for (char *at = line; at; n++) {
        char *comma = strchr(at, ',');
        if (comma) *comma++ = '\0';
        if (n < most) cells[n] = at;
        at = comma;
    }
    return n;
}

/* Of a column: 0 a voltage, 1 the temperature, 2 field_new. */
static int kind_of(int column)
{
    return column < BOARD_CHANNELS ? 0 : column - BOARD_CHANNELS + 1;
}

static int16_t degrees(double value) { return bus_board_status_temperature_encode(value); }

static void put(Sample *s, int column, double value, bool *good)
{
    if (column < BOARD_CHANNELS) {
        *good = isnan(value) || (value >= 0 && value <= ADC_SPAN);
        if (*good) s->volts[column] = isnan(value) ? BOARD_NOT_AVAILABLE : VOLTS_ENCODE(value);
    } else if (column == TEMPERATURE) {
        *good = bus_board_status_temperature_is_in_phys_range(value);
        if (*good) s->temperature = degrees(value);
    } else {
        *good = value == 0 || value == 1;
        s->field_new = value == 1;
    }
}

static Sample *recording(const char *file, size_t *count)
{
    char line[LINE_ROOM], *cells[COLUMNS];
    int order[COLUMNS];
    bool has[COLUMNS] = {false};
    size_t room = 0, number = 1;
    Sample *samples = NULL;
    FILE *f = fopen(file, "r");
    if (!f) fail("recording", file, strerror(errno));
    if (!fgets(line, sizeof line, f)) fail("recording", file, "it is empty");
    const int columns = cells_of(line, cells, COLUMNS);
    if (columns > COLUMNS) fail("recording", file, "its header has more columns than are known");
    for (int i = 0; i < columns; i++) {
        int c = 0;
        while (c < COLUMNS && strcmp(cells[i], NAMES[c]) != 0) c++;
        if (c == COLUMNS) bad_line(file, 1, "a column is not known:", cells[i]);
        if (has[c]) bad_line(file, 1, "a column stands twice:", cells[i]);
        has[c] = true;
        order[i] = c;
    }
    for (int c = 0; c < BOARD_CHANNELS; c++)
        if (!has[c]) bad_line(file, 1, "a column is missing:", NAMES[c]);

    for (*count = 0; fgets(line, sizeof line, f); ++*count) {
        number++;
        if (cells_of(line, cells, COLUMNS) != columns)
            bad_line(file, number, "there are more or fewer cells than in the header:", line);
        if (*count == room) {
            room = room ? 2 * room : 4096;
            samples = realloc(samples, room * sizeof *samples);
            if (!samples) fail("recording", file, "it does not fit into memory");
        }
        Sample *s = &samples[*count];
        memset(s, 0, sizeof *s);
        s->temperature = degrees(25.0);
        s->field_new = true;
        for (int i = 0; i < columns; i++) {
            char *end;
            bool good = true;
            double value = strtod(cells[i], &end);
            if (end == cells[i] || *end != '\0') bad_line(file, number, "no number:", cells[i]);
            put(s, order[i], value, &good);
            if (!good) bad_line(file, number, RANGES[kind_of(order[i])], cells[i]);
        }
    }
    if (ferror(f)) fail("recording", file, strerror(errno));
    fclose(f);
    if (*count == 0) fail("recording", file, "it has a header and no samples");
    return samples;
}

/* ---- The line to the host ------------------------------------------------------------------ */

/* Makes a terminal, and a link to it that appears whole. */
static void plug_in(Line *line, const char *link)
{
    char aside[4096];
    struct termios raw;
    line->fd = posix_openpt(O_RDWR | O_NOCTTY);
    if (line->fd < 0 || grantpt(line->fd) || unlockpt(line->fd))
        fail("terminal for", link, strerror(errno));
    snprintf(line->name, sizeof line->name, "%s", ptsname(line->fd));
    if (fcntl(line->fd, F_SETFL, O_NONBLOCK) || tcgetattr(line->fd, &raw))
        fail("terminal", line->name, strerror(errno));
    /* No echo and no change to any character, before a host has asked for it. */
    raw.c_iflag = 0;
    raw.c_oflag = 0;
    raw.c_lflag = 0;
    raw.c_cflag = CS8 | CREAD | CLOCAL;
    raw.c_cc[VMIN] = 1;
    raw.c_cc[VTIME] = 0;
    if (tcsetattr(line->fd, TCSANOW, &raw)) fail("terminal", line->name, strerror(errno));
    struct stat there;
    if (lstat(link, &there) == 0 && !S_ISLNK(there.st_mode))
        fail("link", link, "there is something else at this path");
    if (snprintf(aside, sizeof aside, "%s.%ld", link, (long)getpid()) >= (int)sizeof aside)
        fail("link", link, "the path is too long");
    unlink(aside);
    if (symlink(line->name, aside) || rename(aside, link)) {
        int error = errno;
        unlink(aside);
        fail("link", link, strerror(error));
    }
    line->waiting = 0;
}

static void unplug(Line *line, const char *link)
{
    char target[128];
    ssize_t n = readlink(link, target, sizeof target - 1);
    /* Another board may have taken the link over. */
    if (n > 0 && strlen(line->name) == (size_t)n && memcmp(target, line->name, (size_t)n) == 0)
        unlink(link);
    close(line->fd);
    line->fd = -1;
}

/* Whole lines only: what has no room is not begun. */
static bool queue(Line *line, const char *text, size_t size)
{
    if (line->fd < 0 || size > sizeof line->out - line->waiting) return false;
    memcpy(line->out + line->waiting, text, size);
    line->waiting += size;
    return true;
}

static void flush(Line *line)
{
    if (line->fd < 0 || line->waiting == 0) return;
    ssize_t n = write(line->fd, line->out, line->waiting);
    if (n <= 0) return;
    line->waiting -= (size_t)n;
    memmove(line->out, line->out + n, line->waiting);
}

static void reply(void *context, const char *text, size_t size)
{
    Host *h = context;
    if (!queue(&h->line, text, size)) h->slcan.flags |= SLCAN_OVERRUN;
}

static void hear(void *context, const Frame *frame)
{
    Host *h = context;
    board_hear(&h->board, frame);
}

static void listen_to_host(Host *h)
{
    char text[4096];
    ssize_t n;
    if (h->line.fd < 0) return;
    while ((n = read(h->line.fd, text, sizeof text)) > 0)
        slcan_take(&h->slcan, text, (size_t)n, hear, reply, h);
    if (n < 0 && errno == EIO) { /* the host has let go of the terminal */
        tcflush(h->line.fd, TCIOFLUSH);
        memset(&h->slcan, 0, sizeof h->slcan);
        h->line.waiting = 0;
    }
}

static void send_frames(Host *h, const Frame *frames, int n)
{
    char text[SLCAN_LINE];
    if (!h->slcan.open || h->slcan.bus_off) return;
    for (int i = 0; i < n; i++) {
        if (queue(&h->line, text, slcan_write(&h->slcan, &frames[i], h->board.ms, text))) continue;
        h->slcan.flags |= SLCAN_OVERRUN;
        h->line.unsent += h->line.fd >= 0;
    }
}

/* ---- A millisecond ------------------------------------------------------------------------- */

static void open_log(Host *h)
{
    if (!h->options.log) return;
    h->log = fopen(h->options.log, "w");
    if (!h->log) fail("log", h->options.log, strerror(errno));
    setvbuf(h->log, NULL, _IOFBF, 1 << 20); /* the disk must not hold up a sample */
    fputs("sample,volts_1,volts_2,volts_3,mode,crc,length,repeated,lost,sequence,range,timeout,"
          "heartbeat,unknown\n",
          h->log);
}

static void log_sample(const Host *h, uint32_t sample)
{
    const Board *b = &h->board;
    const Counts *c = &b->counts;
    if (!h->log) return;
    fprintf(h->log, "%u,%.3f,%.3f,%.3f,%u,%u,%u,%u,%u,%u,%u,%u,%u,%u\n", sample,
            bus_piezo_command_volts_1_decode(b->applied[0]),
            bus_piezo_command_volts_2_decode(b->applied[1]),
            bus_piezo_command_volts_3_decode(b->applied[2]), b->mode, c->crc, c->length,
            c->repeated, c->lost, c->sequence, c->range, c->timeout, c->heartbeat, c->unknown);
}

static void millisecond(Host *h)
{
    static Frame frames[BOARD_FRAMES], sent[FAULT_FRAMES];
    Board *b = &h->board;
    listen_to_host(h);

    if (b->state != OPERATIONAL) {
        send_frames(h, frames, board_tick(b, NULL, frames));
        flush(&h->line);
        return;
    }
    const uint32_t k = b->sample;
    faults_begin(&h->faults, k);
    slcan_bus(&h->slcan, h->faults.met[FAULT_BUS_OFF], reply, h);
    if (h->faults.met[FAULT_UNPLUG] && h->line.fd >= 0) {
        unplug(&h->line, h->options.link);
        memset(&h->slcan, 0, sizeof h->slcan);
    }
    if (!h->faults.met[FAULT_UNPLUG] && h->line.fd < 0) plug_in(&h->line, h->options.link);

    const Sample sample = faults_sample(&h->faults, &h->samples[k % h->count]);
    const int n = board_tick(b, &sample, frames);
    send_frames(h, sent, faults_frames(&h->faults, k, frames, n, sent));
    flush(&h->line);
    log_sample(h, k);

    if (!h->options.loop && b->sample == h->count) {
        board_stop(b);
        slcan_bus(&h->slcan, false, reply, h);
        if (h->line.fd < 0) plug_in(&h->line, h->options.link);
    }
}

static long long now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000 * MS + t.tv_nsec;
}

static void sleep_until(long long ns)
{
    const struct timespec t = {.tv_sec = ns / (1000 * MS), .tv_nsec = ns % (1000 * MS)};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) == EINTR && !told_to_end) {
    }
}

static void hurry(int priority)
{
    const struct sched_param wanted = {.sched_priority = priority};
    if (priority && sched_setscheduler(0, SCHED_FIFO, &wanted))
        fprintf(stderr, "board: no priority %d: %s\n", priority, strerror(errno));
}

static bool is_over(const Host *h, pid_t parent)
{
    if (told_to_end || (h->options.with_parent && getppid() != parent)) return true;
    const bool stopped = h->board.state == BUS_BOARD_HEARTBEAT_BOARD_STATE_STOPPED_CHOICE;
    return stopped && board_at_rest(&h->board) &&
           (!h->slcan.open || h->board.ms >= LINGER_MS);
}

int main(int argc, char **argv)
{
    static Host h;
    const pid_t parent = getppid();
    h.options = options_of(argc, argv, &h.faults);
    h.samples = recording(h.options.samples, &h.count);
    open_log(&h);

    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    board_start(&h.board);
    plug_in(&h.line, h.options.link);

    hurry(h.options.priority);

    const double period = 1e6 / (1 + h.options.drift * 1e-6);
    const long long begin = now();
    long long latest = 0;
    for (long long tick = 0; !is_over(&h, parent); tick++) {
        const long long due = begin + llround((double)tick * period);
        sleep_until(due);
        const long long late = now() - due;
        if (late > latest) latest = late;
        millisecond(&h);
    }

    if (h.line.fd >= 0) unplug(&h.line, h.options.link);
    bool kept = !h.log || (!ferror(h.log) && fclose(h.log) == 0);
    if (!kept) fail("log", h.options.log, "it could not be written");
    printf("{\"samples\": %u, \"unsent\": %lu, \"latest_us\": %lld}\n", h.board.sample,
           h.line.unsent, latest / 1000);
    return 0;
}
