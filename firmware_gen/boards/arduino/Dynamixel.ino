// {title}
//
// For boards that Dynamixel2Arduino knows, as the OpenRB-150. Open the console at any rate on USB, at
// SERVOLVE_CONSOLE_BAUD otherwise, and type help.

#include <Dynamixel2Arduino.h>
#include <{header}>

#if defined(ARDUINO_OpenRB)
#define DXL_SERIAL Serial1
#define CONSOLE_SERIAL Serial
#define SENSOR_SERIAL Serial3  // RX is pin 13
const int DXL_DIR_PIN = -1;    // the board turns the line by itself
#elif defined(ARDUINO_OpenCR)
#define DXL_SERIAL Serial3
#define CONSOLE_SERIAL Serial
#define SENSOR_SERIAL Serial1
const int DXL_DIR_PIN = 84;
#elif defined(ARDUINO_AVR_MEGA2560)  // with a DYNAMIXEL Shield, which takes the USB's serial port
#define DXL_SERIAL Serial
#define CONSOLE_SERIAL Serial1
#define SENSOR_SERIAL Serial2
const int DXL_DIR_PIN = 2;
#else  // boards with a DYNAMIXEL Shield, and your own
#define DXL_SERIAL Serial1
#define CONSOLE_SERIAL Serial
#define SENSOR_SERIAL Serial2
const int DXL_DIR_PIN = 2;
#endif

const int STOP_PIN = 4;    // a contact to ground that opens to stop; -1 only for a bench without one
const int START_PIN = -1;  // a contact to ground that closes, or none

DYNAMIXEL::SerialPortHandler port(DXL_SERIAL, DXL_DIR_PIN);
ServolvePortBus<DYNAMIXEL::SerialPortHandler> bus(port, DXL_SERIAL);

void setup() {
#if defined(BDPIN_DXL_PWR_EN)
  pinMode(BDPIN_DXL_PWR_EN, OUTPUT);
  digitalWrite(BDPIN_DXL_PWR_EN, HIGH);
  delay(300);  // servos boot
#endif
  CONSOLE_SERIAL.begin(SERVOLVE_CONSOLE_BAUD);
  SENSOR_SERIAL.begin(SERVOLVE_SENSOR_BAUD);
  // the watchdog of your board goes where NULL stands; on AVR there is one already
  const ServolveBoard board = {&bus, &SENSOR_SERIAL, &CONSOLE_SERIAL, STOP_PIN, START_PIN, NULL};
  servolve_setup(board);
}

void loop() { servolve_loop(); }
