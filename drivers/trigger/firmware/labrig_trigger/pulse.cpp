#include "pulse.h"

void pulse_begin(Pulse *pulse, void (*drive)(bool high)) {
    pulse->drive = drive;
    pulse->width_us = 100;
    pulse->delay_us = 0;
    pulse->source = SOURCE_HOST;
    pulse->fired = 0;
    pulse_safe(pulse);
}

void pulse_arm(Pulse *pulse) { pulse->armed = true; }

void pulse_safe(Pulse *pulse) {
    pulse->drive(false);
    pulse->phase = PHASE_IDLE;
    pulse->armed = false;
}

bool pulse_fire(Pulse *pulse, uint32_t now_us) {
    if (!pulse->armed || pulse->phase != PHASE_IDLE) {
        return false;
    }
    pulse->phase = pulse->source == SOURCE_SYNC ? PHASE_SYNC : PHASE_DELAY;
    pulse->since_us = now_us;
    pulse_poll(pulse, now_us);
    return true;
}

void pulse_sync(Pulse *pulse, uint32_t edge_us) {
    if (pulse->phase == PHASE_SYNC) {
        pulse->phase = PHASE_DELAY;
        pulse->since_us = edge_us;
    }
}

// Differences of unsigned microseconds stay right when micros() wraps after 71 minutes.
void pulse_poll(Pulse *pulse, uint32_t now_us) {
    if (pulse->phase == PHASE_DELAY && now_us - pulse->since_us >= pulse->delay_us) {
        pulse->drive(true);
        pulse->fired++;
        pulse->phase = PHASE_HIGH;
        pulse->since_us = now_us;
    } else if (pulse->phase == PHASE_HIGH && now_us - pulse->since_us >= pulse->width_us) {
        pulse->drive(false);
        pulse->phase = PHASE_IDLE;
    }
}
