#include "protocol.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const uint32_t WIDTH_MIN_US = 10, WIDTH_MAX_US = 1000000;
static const uint32_t DELAY_MAX_US = 10000000;
static const uint32_t WATCHDOG_MIN_MS = 100, WATCHDOG_MAX_MS = 600000;

void protocol_begin(Protocol *p, Pulse *pulse, void (*reply)(const char *line)) {
    memset(p, 0, sizeof *p);
    p->pulse = pulse;
    p->reply = reply;
    p->watchdog_ms = 5000;
}

// CRC-8, polynomial x^8 + x^2 + x + 1: a byte lost or garbled on the wire must not become a command.
static uint8_t crc8(const char *text, size_t n) {
    uint8_t crc = 0;
    for (size_t i = 0; i < n; i++) {
        crc ^= (uint8_t)text[i];
        for (uint8_t bit = 0; bit < 8; bit++) {
            crc = (crc & 0x80) ? (uint8_t)((crc << 1) ^ 0x07) : (uint8_t)(crc << 1);
        }
    }
    return crc;
}

static void answer(Protocol *p, const char *tag, const char *body) {
    char line[LINE_MAX_CHARS + 24];
    const int n = snprintf(line, sizeof line - 5, "%s %s", tag, body);
    snprintf(line + n, sizeof line - n, "*%02X\n", crc8(line, (size_t)n));
    p->reply(line);
}

static bool number(char **rest, uint32_t low, uint32_t high, uint32_t *value) {
    char *word = strtok_r(NULL, " ", rest);
    if (word == NULL || *word < '0' || *word > '9') {
        return false;
    }
    char *end;
    *value = strtoul(word, &end, 10);
    return *end == '\0' && strlen(word) <= 9 && *value >= low && *value <= high;
}

static void set_pulse(Protocol *p, const char *tag, char **rest) {
    uint32_t width_us, delay_us, source;
    if (!number(rest, WIDTH_MIN_US, WIDTH_MAX_US, &width_us) ||
        !number(rest, 0, DELAY_MAX_US, &delay_us) || !number(rest, 0, 1, &source)) {
        answer(p, tag, "err range");
        return;
    }
    pulse_safe(p->pulse); // a width changed in mid-pulse would be neither
    p->pulse->width_us = width_us;
    p->pulse->delay_us = delay_us;
    p->pulse->source = (Source)source;
    answer(p, tag, "ok");
}

static void set_watchdog(Protocol *p, const char *tag, char **rest) {
    uint32_t watchdog_ms;
    if (!number(rest, WATCHDOG_MIN_MS, WATCHDOG_MAX_MS, &watchdog_ms)) {
        answer(p, tag, "err range");
        return;
    }
    p->watchdog_ms = watchdog_ms;
    answer(p, tag, "ok");
}

static void fire(Protocol *p, const char *tag, uint32_t now_us) {
    char body[24];
    const unsigned long count = (unsigned long)p->pulse->fired + 1;
    if (!p->pulse->armed) {
        answer(p, tag, p->tripped ? "err watchdog" : "err disarmed");
    } else if (!pulse_fire(p->pulse, now_us)) {
        answer(p, tag, "err busy");
    } else {
        snprintf(body, sizeof body, "ok %lu", count);
        answer(p, tag, body);
    }
}

static void report_state(Protocol *p, const char *tag) {
    const Pulse *pulse = p->pulse;
    char body[LINE_MAX_CHARS];
    snprintf(body, sizeof body, "ok %u %lu %lu %u %lu %u %lu", pulse->armed,
             (unsigned long)pulse->width_us, (unsigned long)pulse->delay_us, pulse->source,
             (unsigned long)p->watchdog_ms, p->tripped, (unsigned long)p->bad_lines);
    answer(p, tag, body);
}

static void report_counters(Protocol *p, const char *tag) {
    char body[LINE_MAX_CHARS];
    snprintf(body, sizeof body, "ok %lu %lu %lu", (unsigned long)p->pulse->fired,
             (unsigned long)p->strobes, (unsigned long)p->syncs);
    answer(p, tag, body);
}

static void report_identity(Protocol *p, const char *tag) {
    char body[LINE_MAX_CHARS];
    snprintf(body, sizeof body, "ok labrig-trigger %u %s", PROTOCOL_VERSION, FIRMWARE_VERSION);
    answer(p, tag, body);
}

static void obey(Protocol *p, const char *tag, const char *command, char **rest, uint32_t now_us) {
    if (strcmp(command, "id") == 0) {
        report_identity(p, tag);
    } else if (strcmp(command, "set") == 0) {
        set_pulse(p, tag, rest);
    } else if (strcmp(command, "dog") == 0) {
        set_watchdog(p, tag, rest);
    } else if (strcmp(command, "arm") == 0) {
        p->tripped = false;
        pulse_arm(p->pulse);
        answer(p, tag, "ok");
    } else if (strcmp(command, "safe") == 0) {
        pulse_safe(p->pulse);
        answer(p, tag, "ok");
    } else if (strcmp(command, "fire") == 0) {
        fire(p, tag, now_us);
    } else if (strcmp(command, "count") == 0) {
        report_counters(p, tag);
    } else if (strcmp(command, "state") == 0) {
        report_state(p, tag);
    } else {
        answer(p, tag, "err unknown");
    }
}

// A line that is not whole gets no answer: who sent it cannot be known from a damaged tag.
static void take_line(Protocol *p, uint32_t now_ms, uint32_t now_us) {
    char *star = strrchr(p->line, '*');
    if (star == NULL || strlen(star) != 3 ||
        strtoul(star + 1, NULL, 16) != crc8(p->line, (size_t)(star - p->line))) {
        p->bad_lines++;
        return;
    }
    *star = '\0';
    char *rest;
    const char *tag = strtok_r(p->line, " ", &rest);
    const char *command = tag == NULL ? NULL : strtok_r(NULL, " ", &rest);
    if (command == NULL || strlen(tag) > 5) {
        p->bad_lines++;
        return;
    }
    p->heard_ms = now_ms;
    obey(p, tag, command, &rest, now_us);
}

void protocol_byte(Protocol *p, char c, uint32_t now_ms, uint32_t now_us) {
    if (c == '\n') {
        p->line[p->length] = '\0';
        if (p->overlong) {
            p->bad_lines++;
        } else if (p->length > 0) {
            take_line(p, now_ms, now_us);
        }
        p->length = 0;
        p->overlong = false;
    } else if (p->length == LINE_MAX_CHARS) {
        p->overlong = true;
    } else {
        p->line[p->length++] = c;
    }
}

void protocol_poll(Protocol *p, uint32_t now_ms) {
    if (p->pulse->armed && now_ms - p->heard_ms >= p->watchdog_ms) {
        p->tripped = true;
        pulse_safe(p->pulse);
    }
}
