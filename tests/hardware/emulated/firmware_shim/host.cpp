// Runs the trigger's firmware on a host: its serial port is a pty, its pins are lines of text.
//
//   firmware_host [MICROS_AT_START]
//
// The first line of standard output names the pty; each edge of an output pin follows as
// "PIN LEVEL MONOTONIC_US". On standard input, 's' is an edge of the camera's strobe, 'y' one of the
// projector's sync, 'e' makes the camera answer each pulse with a strobe, 'h' halts the processor.

#include <Arduino.h>

#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

SerialPort Serial;
static int master;
static char received[4096];
static int received_count, received_next;
static void (*handlers[16])();
static uint64_t started_us, offset_us;
static bool echo_strobe, halted;

static uint64_t monotonic_us() {
    timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

uint32_t micros() { return (uint32_t)(monotonic_us() - started_us + offset_us); }
uint32_t millis() { return (uint32_t)((monotonic_us() - started_us + offset_us) / 1000u); }
void pinMode(uint8_t, uint8_t) {}
void attachInterrupt(uint8_t interrupt, void (*handler)(), int) { handlers[interrupt] = handler; }

void digitalWrite(uint8_t pin, uint8_t level) {
    static uint8_t levels[16];
    if (levels[pin] == level) {
        return;
    }
    levels[pin] = level;
    printf("%u %u %llu\n", pin, level, (unsigned long long)monotonic_us());
    fflush(stdout);
    if (level == HIGH && echo_strobe) {
        handlers[2]();
    }
}

void SerialPort::begin(uint32_t) {}
int SerialPort::available() { return received_count - received_next; }
int SerialPort::read() { return received_next < received_count ? received[received_next++] : -1; }

size_t SerialPort::write(const char *line) {
    return (size_t)::write(master, line, strlen(line));
}

static bool obey_stdin() {
    char order;
    if (::read(STDIN_FILENO, &order, 1) <= 0) {
        return false;
    }
    if (order == 's') handlers[2]();
    if (order == 'y') handlers[3]();
    if (order == 'e') echo_strobe = true;
    if (order == 'h') halted = true;
    return true;
}

static void open_port() {
    master = posix_openpt(O_RDWR | O_NOCTTY);
    grantpt(master);
    unlockpt(master);
    // Held open here too, so that the port stays up between two programs that use it, as a real one.
    const int slave = open(ptsname(master), O_RDWR | O_NOCTTY);
    termios raw;
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    printf("%s\n", ptsname(master));
    fflush(stdout);
}

int main(int argc, char **argv) {
    started_us = monotonic_us();
    offset_us = argc > 1 ? strtoull(argv[1], nullptr, 10) : 0;
    open_port();
    setup();
    for (;;) {
        pollfd wires[2] = {{master, POLLIN, 0}, {STDIN_FILENO, POLLIN, 0}};
        const timespec wait = {0, 100000};
        ppoll(wires, halted ? 0 : 2, &wait, nullptr);
        if ((wires[1].revents & (POLLIN | POLLHUP)) && !obey_stdin()) {
            return 0;
        }
        if (halted) {
            pause();
        }
        if ((wires[0].revents & POLLIN) && received_next == received_count) {
            const ssize_t n = ::read(master, received, sizeof received);
            received_next = 0;
            received_count = n > 0 ? (int)n : 0;
        }
        loop();
    }
}
