// {title}
//
// Over a serial port and a direction pin, with no other library: for servos behind a half-duplex buffer of your own, as
// Feetech STS servos behind a bus linker, or DYNAMIXEL servos behind a 74LVC2G241. Open the console at
// SERVOLVE_CONSOLE_BAUD, and type help.

#include <{header}>

#define BUS_SERIAL Serial1
#define CONSOLE_SERIAL Serial
#define SENSOR_SERIAL Serial2

const int DIRECTION_PIN = 2;  // high while sending; -1 where the line turns by itself
const int STOP_PIN = 3;       // a contact to ground that opens to stop; -1 only for a bench without one
const int START_PIN = -1;     // a contact to ground that closes, or none

ServolveSerialBus bus(BUS_SERIAL, DIRECTION_PIN);

void setup() {
  CONSOLE_SERIAL.begin(SERVOLVE_CONSOLE_BAUD);
  SENSOR_SERIAL.begin(SERVOLVE_SENSOR_BAUD);
  // the watchdog of your board goes where NULL stands; on AVR there is one already
  const ServolveBoard board = {&bus, &SENSOR_SERIAL, &CONSOLE_SERIAL, STOP_PIN, START_PIN, NULL};
  servolve_setup(board);
}

void loop() { servolve_loop(); }
