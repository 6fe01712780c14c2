// The firmware's board functions (sv_hal.h) over what every Arduino has: serial ports, pins and micros().

#include "servolve_arduino.h"

#include "sv_hal.h"
#include "sv_robot.h"
#include "sv_time.h"

#if defined(__AVR__)
#include <avr/wdt.h>
#endif

namespace {

const int32_t kBusBytes = SV_FRAME_MAX;  // answers to one question
const int32_t kConsoleBytes = 256;       // of the log, on their way out
const uint32_t kGapUs = 60;              // silence of the bus after which an answer is taken to be over

ServolveBoard board;
sv_robot robot;
float registers[SERVOLVE_NREGISTER];
float memory[SERVOLVE_NSTATE];

uint32_t inputs_seen;

uint8_t bus_bytes[kBusBytes];
int32_t nbus;
int32_t bus_read;

uint8_t console_bytes[kConsoleBytes];
int32_t nconsole;
int32_t console_sent;

// Take what the bus has received, all of an answer: the port's own buffer is small, and parsing takes its time.
void collect_bus() {
  uint32_t heard_us = micros();
  while (nbus < kBusBytes && board.bus->available() > 0) {
    do {
      bus_bytes[nbus++] = static_cast<uint8_t>(board.bus->read());
    } while (nbus < kBusBytes && board.bus->available() > 0);
    heard_us = micros();
    while (board.bus->available() <= 0 && static_cast<uint32_t>(micros()) - heard_us < kGapUs) {
    }
  }
}

// Give the console what its port takes without waiting.
void pump_console() {
  while (console_sent < nconsole) {
    const int room = board.console->availableForWrite();
    if (room <= 0) {
      return;
    }
    const int32_t left = nconsole - console_sent;
    const int32_t n = static_cast<int32_t>(
        board.console->write(console_bytes + console_sent, static_cast<size_t>(left < room ? left : room)));
    if (n <= 0) {
      return;
    }
    console_sent += n;
  }
  nconsole = 0;
  console_sent = 0;
}

int32_t read_stream(Stream* stream, uint8_t* data, int32_t size) {
  int32_t n = 0;
  while (stream && n < size && stream->available() > 0) {
    data[n++] = static_cast<uint8_t>(stream->read());
  }
  return n;
}

int32_t read_bus(uint8_t* data, int32_t size) {
  collect_bus();
  int32_t n = 0;
  while (n < size && bus_read < nbus) {
    data[n++] = bus_bytes[bus_read++];
  }
  if (bus_read == nbus) {
    nbus = 0;
    bus_read = 0;
  }
  return n;
}

bool is_something_there() {
  return bus_read < nbus || board.bus->available() > 0 || (board.sensors && board.sensors->available() > 0) ||
         board.console->available() > 0 || sv_hal_inputs() != inputs_seen;
}

#if defined(__AVR__)

// Why this start: the flags are gone where a boot loader has cleared them; a mark that power-off wipes is not.
const uint32_t kMark = 0x5E7F0001UL;
uint32_t mark __attribute__((section(".noinit")));
uint8_t flags __attribute__((section(".noinit")));

void keep_flags() __attribute__((naked, used, section(".init3")));
void keep_flags() {
  flags = MCUSR;
  MCUSR = 0;
  wdt_disable();
}

bool is_bitten() { return flags ? (flags & (1 << WDRF)) != 0 : mark == kMark; }

void feed_own_watchdog() {
  if (mark != kMark) {
    mark = kMark;
    wdt_enable(WDTO_120MS);
  }
  wdt_reset();
}

#else

bool is_bitten() { return false; }
void feed_own_watchdog() {}

#endif

int32_t cause = SV_RESET_POWER;

}  // namespace

void ServolveSerialBus::begin(unsigned long baud) {
  serial_.begin(baud);
  if (pin_ >= 0) {
    pinMode(static_cast<uint8_t>(pin_), OUTPUT);
    digitalWrite(static_cast<uint8_t>(pin_), LOW);
  }
}

int ServolveSerialBus::available() { return serial_.available(); }

int ServolveSerialBus::read() { return serial_.read(); }

void ServolveSerialBus::write(const uint8_t* data, size_t size) {
  if (pin_ >= 0) {
    digitalWrite(static_cast<uint8_t>(pin_), HIGH);
  }
  serial_.write(data, size);
  serial_.flush();
  if (pin_ >= 0) {
    digitalWrite(static_cast<uint8_t>(pin_), LOW);
  }
}

void servolve_setup(const ServolveBoard& what) {
  board = what;
  sv_hal_init();
  sv_robot_init(&robot, &servolve_rig, servolve_selftest(), SERVOLVE_PROGRAM, registers, memory);
}

void servolve_loop() { sv_robot_poll(&robot); }

void sv_hal_init(void) {
  cause = is_bitten() ? SV_RESET_WATCHDOG : SV_RESET_POWER;
#if defined(__AVR__)
  mark = 0;
#endif
  if (board.stop_pin >= 0) {
    pinMode(static_cast<uint8_t>(board.stop_pin), INPUT_PULLUP);
  }
  if (board.start_pin >= 0) {
    pinMode(static_cast<uint8_t>(board.start_pin), INPUT_PULLUP);
  }
  board.bus->begin(SERVOLVE_BUS_BAUD);
}

uint32_t sv_hal_now_us(void) { return micros(); }

void sv_hal_wait(uint32_t until_us) {
  inputs_seen = sv_hal_inputs();
  do {
    pump_console();
    if (is_something_there()) {
      collect_bus();
      return;
    }
  } while (!sv_has_come(sv_hal_now_us(), until_us));
}

int32_t sv_hal_read(int32_t line, uint8_t* data, int32_t size) {
  if (line == SV_LINE_BUS) {
    return read_bus(data, size);
  }
  return read_stream(line == SV_LINE_SENSORS ? board.sensors : board.console, data, size);
}

int32_t sv_hal_write(int32_t line, const uint8_t* data, int32_t size) {
  if (line == SV_LINE_BUS) {
    board.bus->write(data, static_cast<size_t>(size));
    return size;
  }
  if (line != SV_LINE_CONSOLE) {
    return 0;
  }
  pump_console();
  int32_t n = 0;
  while (n < size && nconsole < kConsoleBytes) {
    console_bytes[nconsole++] = data[n++];
  }
  pump_console();
  return n;
}

uint32_t sv_hal_inputs(void) {
  uint32_t inputs = 0;
  if (board.stop_pin >= 0 && digitalRead(static_cast<uint8_t>(board.stop_pin)) == HIGH) {
    inputs |= SV_INPUT_STOP;
  }
  if (board.start_pin >= 0 && digitalRead(static_cast<uint8_t>(board.start_pin)) == LOW) {
    inputs |= SV_INPUT_START;
  }
  return inputs;
}

void sv_hal_feed_watchdog(void) {
  if (board.feed_watchdog) {
    board.feed_watchdog();
  } else {
    feed_own_watchdog();
  }
}

int32_t sv_hal_reset_cause(void) { return cause; }
