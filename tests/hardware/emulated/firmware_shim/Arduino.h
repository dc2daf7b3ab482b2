// The few Arduino functions that the trigger's firmware calls, on a Linux host.
#ifndef ARDUINO_SHIM_H
#define ARDUINO_SHIM_H

#include <stddef.h>
#include <stdint.h>

enum { LOW = 0, HIGH = 1 };
enum { INPUT = 0, OUTPUT = 1 };
enum { RISING = 3 };

uint32_t micros();
uint32_t millis();
void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t level);
void attachInterrupt(uint8_t interrupt, void (*handler)(), int edge);
inline uint8_t digitalPinToInterrupt(uint8_t pin) { return pin; }
inline void noInterrupts() {}
inline void interrupts() {}

struct SerialPort {
    void begin(uint32_t baud);
    int available();
    int read();
    size_t write(const char *line);
};
extern SerialPort Serial;

void setup();
void loop();

#endif
