#include "slcan.h"

#include <string.h>

static const uint8_t LENGTHS[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};
static const char HEX[] = "0123456789ABCDEF";

static int digit(char c)
{
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    return -1;
}

static bool number(const char *text, int digits, uint32_t *value)
{
    *value = 0;
    for (int i = 0; i < digits; i++) {
        int d = digit(text[i]);
        if (d < 0) return false;
        *value = *value << 4 | (uint32_t)d;
    }
    return true;
}

/* Whether a line, without its CR, is a frame, and which one. */
static bool parse(const char *line, size_t size, Frame *f)
{
    uint32_t value;
    memset(f, 0, sizeof *f);
    f->extended = strchr("TRDB", line[0]) != NULL;
    f->remote = strchr("rR", line[0]) != NULL;
    f->fd = strchr("dDbB", line[0]) != NULL;
    const int digits = f->extended ? 8 : 3;
    const size_t head = 1 + (size_t)digits + 1;
    if (size < head || !number(line + 1, digits, &f->id)) return false;
    if (f->id > (f->extended ? 0x1FFFFFFFu : 0x7FFu)) return false;
    const int code = digit(line[head - 1]);
    if (code < 0 || (code > 8 && !f->fd)) return false;
    f->length = LENGTHS[code];
    const size_t bytes = f->remote ? 0 : f->length;
    if (size != head + 2 * bytes) return false;
    for (size_t i = 0; i < bytes; i++) {
        if (!number(line + head + 2 * i, 2, &value)) return false;
        f->data[i] = (uint8_t)value;
    }
    return true;
}

size_t slcan_write(const Slcan *s, const Frame *f, uint32_t ms, char *text)
{
    char *c = text;
    unsigned code = 0;
    while (LENGTHS[code] < f->length) code++;
    *c = f->fd ? 'b' : f->remote ? 'r' : 't';
    if (f->extended) *c = (char)(*c - 'a' + 'A');
    c++;
    for (int shift = f->extended ? 28 : 8; shift >= 0; shift -= 4) *c++ = HEX[f->id >> shift & 15];
    *c++ = HEX[code];
    for (int i = 0; i < f->length && !f->remote; i++) {
        *c++ = HEX[f->data[i] >> 4];
        *c++ = HEX[f->data[i] & 15];
    }
    for (int shift = 12; shift >= 0 && s->stamps; shift -= 4) *c++ = HEX[ms % 60000 >> shift & 15];
    *c++ = '\r';
    return (size_t)(c - text);
}

void slcan_bus(Slcan *s, bool is_off, SlcanReply *reply, void *context)
{
    static const char off[] = "sb000255\r", active[] = "sa000000\r";
    s->bus_off = is_off;
    if (!s->open || s->told_off == is_off) return;
    s->told_off = is_off;
    reply(context, is_off ? off : active, sizeof off - 1);
}

static uint8_t status(Slcan *s)
{
    uint8_t flags = s->flags;
    s->flags = 0;
    if (s->bus_off) flags |= SLCAN_WARNING | SLCAN_PASSIVE | SLCAN_BUS_ERROR;
    return flags;
}

static void obey(Slcan *s, SlcanHear *hear, SlcanReply *reply, void *context)
{
    const char *line = s->line, *answer = "\a";
    const size_t size = s->filled;
    char text[4];
    uint32_t value;
    Frame frame;

    switch (line[0]) {
    case 'S':
        if (!s->open && size == 2 && line[1] >= '0' && line[1] <= '8') answer = "\r";
        break;
    case 's':
        if (!s->open && size == 5 && number(line + 1, 4, &value)) answer = "\r";
        break;
    case 'Y':
        if (!s->open && size == 2 && line[1] >= '0' && line[1] <= '9') answer = "\r";
        break;
    case 'Z':
        if (s->open || size != 2 || (line[1] != '0' && line[1] != '1')) break;
        s->stamps = line[1] == '1';
        answer = "\r";
        break;
    case 'O':
    case 'L':
        if (size != 1 || s->open) break;
        s->open = true;
        s->listen = line[0] == 'L';
        s->told_off = false;
        answer = "\r";
        break;
    case 'C':
        if (size != 1 || !s->open) break;
        s->open = false;
        answer = "\r";
        break;
    case 'V':
        if (size == 1) answer = "V1010\r";
        break;
    case 'N':
        if (size == 1) answer = "NB001\r";
        break;
    case 'F':
        if (size != 1 || !s->open) break;
        value = status(s);
        text[0] = 'F';
        text[1] = HEX[value >> 4];
        text[2] = HEX[value & 15];
        text[3] = '\r';
        reply(context, text, sizeof text);
        return;
    case 't':
    case 'T':
    case 'r':
    case 'R':
    case 'd':
    case 'D':
    case 'b':
    case 'B':
        if (!s->open || s->listen || s->bus_off || !parse(line, size, &frame)) break;
        hear(context, &frame);
        answer = frame.extended ? "Z\r" : "z\r";
        break;
    default:
        break;
    }
    reply(context, answer, strlen(answer));
}

void slcan_take(Slcan *s, const char *text, size_t size, SlcanHear *hear, SlcanReply *reply,
                void *context)
{
    for (size_t i = 0; i < size; i++) {
        if (text[i] != '\r') {
            /* A line feed after the CR is the habit of some hosts. */
            if (text[i] == '\n' && s->filled == 0) continue;
            if (s->filled < sizeof s->line) s->line[s->filled] = text[i];
            if (s->filled <= sizeof s->line) s->filled++;
            continue;
        }
        if (s->filled > sizeof s->line)
            reply(context, "\a", 1);
        else if (s->filled == 0)
            reply(context, "\r", 1); /* an empty line: the host clears the line */
        else
            obey(s, hear, reply, context);
        s->filled = 0;
    }
}
