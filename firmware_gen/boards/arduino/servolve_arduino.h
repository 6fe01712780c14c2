// The firmware on an Arduino: which ports and pins it has, how it is started and kept going.
//
// A sketch says in setup() what it has, by servolve_setup, and calls servolve_loop from loop().

#ifndef SERVOLVE_ARDUINO_H_
#define SERVOLVE_ARDUINO_H_

#include <Arduino.h>

#include "rig.h"

// The servos' line.
class ServolveBus {
 public:
  virtual void begin(unsigned long baud) = 0;
  virtual int available() = 0;
  virtual int read() = 0;
  // Send all, and return once the last bit has left and the line is free for answers.
  virtual void write(const uint8_t* data, size_t size) = 0;
};

// A serial port, with a pin that is high while sending, or -1 where the board turns the line by itself.
class ServolveSerialBus : public ServolveBus {
 public:
  ServolveSerialBus(HardwareSerial& serial, int direction_pin = -1) : serial_(serial), pin_(direction_pin) {}
  void begin(unsigned long baud) override;
  int available() override;
  int read() override;
  void write(const uint8_t* data, size_t size) override;

 private:
  HardwareSerial& serial_;
  const int pin_;
};

// A port of Dynamixel2Arduino, as DYNAMIXEL::SerialPortHandler, which knows what its boards need: power switches,
// direction pins, half-duplex modes. It may return before the last bit has left; the serial port below it tells.
template <class Port>
class ServolvePortBus : public ServolveBus {
 public:
  ServolvePortBus(Port& port, HardwareSerial& serial) : port_(port), serial_(serial) {}
  void begin(unsigned long baud) override { port_.begin(baud); }
  int available() override { return port_.available(); }
  int read() override { return port_.read(); }
  void write(const uint8_t* data, size_t size) override {
    port_.write(const_cast<uint8_t*>(data), size);
    serial_.flush();
  }

 private:
  Port& port_;
  HardwareSerial& serial_;
};

struct ServolveBoard {
  ServolveBus* bus;
  Stream* sensors;  // the sensor node's lines, begun; NULL where the rig has none
  Stream* console;  // commands in, answers and the log out, begun
  int stop_pin;     // emergency stop: a contact to ground that opens to stop; -1: none
  int start_pin;    // start button: a contact to ground that closes; -1: none
  // a watchdog of about 0.1 s, begun by the first call; NULL: the processor's own on AVR, none elsewhere
  void (*feed_watchdog)();
};

// Bring up lines and pins, check the controller on this machine, say hello on the console.
void servolve_setup(const ServolveBoard& board);

// Take commands, and make the runs that they start: does not return while one goes on.
void servolve_loop();

#endif  // SERVOLVE_ARDUINO_H_
