// One pulse on the trigger output: await the source, wait the delay, stay high for the width.
#ifndef LABRIG_PULSE_H
#define LABRIG_PULSE_H

#include <Arduino.h>

enum Source : uint8_t { SOURCE_HOST = 0, SOURCE_SYNC = 1 };
enum Phase : uint8_t { PHASE_IDLE, PHASE_SYNC, PHASE_DELAY, PHASE_HIGH };

struct Pulse {
    void (*drive)(bool high);
    uint32_t width_us;
    uint32_t delay_us;
    Source source;
    Phase phase;
    uint32_t since_us;
    uint32_t fired;
    bool armed;
};

void pulse_begin(Pulse *pulse, void (*drive)(bool high));
void pulse_arm(Pulse *pulse);
void pulse_safe(Pulse *pulse);
bool pulse_fire(Pulse *pulse, uint32_t now_us);
void pulse_sync(Pulse *pulse, uint32_t edge_us);
void pulse_poll(Pulse *pulse, uint32_t now_us);

#endif
