// Reference firmware of the labrig trigger box, for an ATmega328P board (Arduino Uno, Nano).
//
// Wiring: pin 8 to the camera's trigger input, pin 2 from the camera's strobe output, pin 3 from the
// projector's sync output, all 5 V, through opto-couplers; ground of all boxes common.
// The protocol is written down in PROTOCOL.md beside this folder.

#include "pulse.h"
#include "protocol.h"

static const uint8_t PIN_STROBE = 2;
static const uint8_t PIN_SYNC = 3;
static const uint8_t PIN_TRIGGER = 8;
static const uint32_t BAUD = 115200;

static Pulse pulse;
static Protocol protocol;
static volatile uint32_t strobes;
static volatile uint32_t syncs;
static volatile uint32_t sync_at_us;
static uint32_t syncs_seen;

static void on_strobe() { strobes = strobes + 1; }

static void on_sync() {
    sync_at_us = micros();
    syncs = syncs + 1;
}

// 32-bit counters are read byte by byte on this processor: an edge between two bytes would tear one.
static uint32_t read_whole(const volatile uint32_t &counter) {
    noInterrupts();
    const uint32_t value = counter;
    interrupts();
    return value;
}

static void drive(bool high) { digitalWrite(PIN_TRIGGER, high ? HIGH : LOW); }

static void reply(const char *line) { Serial.write(line); }

void setup() {
    pinMode(PIN_TRIGGER, OUTPUT);
    drive(false);
    pinMode(PIN_STROBE, INPUT);
    pinMode(PIN_SYNC, INPUT);
    attachInterrupt(digitalPinToInterrupt(PIN_STROBE), on_strobe, RISING);
    attachInterrupt(digitalPinToInterrupt(PIN_SYNC), on_sync, RISING);
    pulse_begin(&pulse, drive);
    protocol_begin(&protocol, &pulse, reply);
    Serial.begin(BAUD);
}

void loop() {
    const uint32_t edges = read_whole(syncs);
    if (edges != syncs_seen) {
        syncs_seen = edges;
        pulse_sync(&pulse, read_whole(sync_at_us));
    }
    pulse_poll(&pulse, micros());
    protocol_poll(&protocol, millis());
    protocol.strobes = read_whole(strobes);
    protocol.syncs = edges;
    while (Serial.available() > 0) {
        protocol_byte(&protocol, (char)Serial.read(), millis(), micros());
        pulse_poll(&pulse, micros());
    }
}
