// The line protocol "labrig-trigger 1": tagged commands with a checksum, one reply each.
#ifndef LABRIG_PROTOCOL_H
#define LABRIG_PROTOCOL_H

#include "pulse.h"

static const uint8_t PROTOCOL_VERSION = 1;
static const char FIRMWARE_VERSION[] = "1.0";
static const uint8_t LINE_MAX_CHARS = 60;

struct Protocol {
    Pulse *pulse;
    void (*reply)(const char *line);
    char line[LINE_MAX_CHARS + 1];
    uint8_t length;
    bool overlong;
    uint32_t heard_ms;
    uint32_t watchdog_ms;
    bool tripped;
    uint32_t bad_lines;
    uint32_t strobes;
    uint32_t syncs;
};

void protocol_begin(Protocol *p, Pulse *pulse, void (*reply)(const char *line));
void protocol_byte(Protocol *p, char c, uint32_t now_ms, uint32_t now_us);
void protocol_poll(Protocol *p, uint32_t now_ms);

#endif
