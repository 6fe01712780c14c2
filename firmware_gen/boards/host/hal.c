// The native twin: the firmware as a process whose time and bytes come from a runner, over standard input and output.
//
//   twin => runner   'W' i64 until_us: wait, until the runner has answered
//                    'B' u32 n, bytes: sent on the bus;  'C' u32 n, bytes: sent on the console
//   runner => twin   for each 'W': i64 now_us, u32 inputs, then bus, sensors, console: u32 n, bytes
//
// Numbers are little endian. The end of the input ends the process. Time moves in sv_hal_wait only. The watchdog bites
// after WATCHDOG_US of that time without food, or after a second of computing without: the process then starts anew, as
// a board would, and says that the watchdog has reset it.

#define _XOPEN_SOURCE 700  // sigaction, setitimer

#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/time.h>
#include <unistd.h>

#include "sv_hal.h"

#define NLINE 3
#define RECEIVED_MAX 65536  // bytes of a line that wait to be read; what comes beyond is lost, as in a board's buffer
#define SENT_MAX 65536      // bytes for the runner until the next wait
#define WATCHDOG_US 150000
#define HUNG_S 1

typedef struct {
  uint8_t bytes[RECEIVED_MAX];
  uint32_t first;
  uint32_t n;
} received;

static received lines[NLINE];
static uint8_t sent[SENT_MAX];
static size_t nsent;
static int64_t now_us;
static int64_t fed_us = -1;  // < 0: never
static uint32_t inputs;
static int32_t cause = SV_RESET_POWER;

// The watchdog's reset: start anew, at the time that it is.
static void bite(int64_t at_us) {
  char time[] = "SERVOLVE_NOW_US=0000000000000000000";
  for (size_t i = sizeof time - 2; at_us > 0; i--) {
    time[i] = (char)('0' + at_us % 10);
    at_us /= 10;
  }
  char name[] = "firmware";
  char reset[] = "SERVOLVE_RESET=watchdog";
  char* const arguments[] = {name, 0};
  char* const environment[] = {reset, time, 0};
  execve("/proc/self/exe", arguments, environment);
  _exit(70);
}

static void on_hung(int signal_number) {
  (void)signal_number;
  bite(now_us);
}

// Give the process a second of computing until the next food.
static void wind_up(void) {
  const struct itimerval second = {.it_value = {.tv_sec = HUNG_S}};
  setitimer(ITIMER_VIRTUAL, &second, 0);
}

static void flush(void) {
  size_t done = 0;
  while (done < nsent) {
    const ssize_t n = write(STDOUT_FILENO, sent + done, nsent - done);
    if (n <= 0) {
      _exit(0);  // the runner has gone
    }
    done += (size_t)n;
  }
  nsent = 0;
}

static void put(const void* data, size_t n) {
  if (nsent + n > SENT_MAX) {
    flush();
  }
  memcpy(sent + nsent, data, n);
  nsent += n;
}

static void put_number(uint64_t value, size_t size) {
  uint8_t bytes[8];
  for (size_t i = 0; i < size; i++) {
    bytes[i] = (uint8_t)(value >> (8 * i));
  }
  put(bytes, size);
}

static uint8_t get_byte(void) {
  static uint8_t buffer[4096];
  static ssize_t next;
  static ssize_t n;
  if (next == n) {
    next = 0;
    n = read(STDIN_FILENO, buffer, sizeof buffer);
    if (n <= 0) {
      _exit(0);  // the runner has gone
    }
  }
  return buffer[next++];
}

static uint64_t get_number(size_t size) {
  uint64_t value = 0;
  for (size_t i = 0; i < size; i++) {
    value |= (uint64_t)get_byte() << (8 * i);
  }
  return value;
}

// Take the bytes that the runner gives a line.
static void get_line(received* line) {
  uint64_t n = get_number(4);
  while (n-- > 0) {
    const uint8_t byte = get_byte();
    if (line->n < RECEIVED_MAX) {
      line->bytes[(line->first + line->n++) % RECEIVED_MAX] = byte;
    }
  }
}

void sv_hal_init(void) {
  const char* reset = getenv("SERVOLVE_RESET");
  const char* at_us = getenv("SERVOLVE_NOW_US");
  if (reset) {
    cause = strcmp(reset, "watchdog") == 0 ? SV_RESET_WATCHDOG : strcmp(reset, "fault") == 0 ? SV_RESET_FAULT : cause;
  }
  now_us = at_us ? strtoll(at_us, 0, 10) : 0;

  // a process that was started by its signal's handler has that signal blocked
  sigset_t hung;
  sigemptyset(&hung);
  sigaddset(&hung, SIGVTALRM);
  sigprocmask(SIG_UNBLOCK, &hung, 0);
  const struct sigaction act = {.sa_handler = on_hung};
  sigaction(SIGVTALRM, &act, 0);
  signal(SIGPIPE, SIG_IGN);
}

uint32_t sv_hal_now_us(void) { return (uint32_t)now_us; }

void sv_hal_wait(uint32_t until_us) {
  const int64_t until = now_us + (int32_t)(until_us - (uint32_t)now_us);
  put("W", 1);
  put_number((uint64_t)until, 8);
  flush();
  now_us = (int64_t)get_number(8);
  inputs = (uint32_t)get_number(4);
  for (int32_t i = 0; i < NLINE; i++) {
    get_line(lines + i);
  }
  if (fed_us >= 0 && now_us - fed_us > WATCHDOG_US) {
    bite(now_us);
  }
}

int32_t sv_hal_read(int32_t line, uint8_t* data, int32_t size) {
  received* from = lines + line;
  int32_t n = 0;
  while (n < size && from->n > 0) {
    data[n++] = from->bytes[from->first];
    from->first = (from->first + 1) % RECEIVED_MAX;
    from->n--;
  }
  return n;
}

int32_t sv_hal_write(int32_t line, const uint8_t* data, int32_t size) {
  if (line == SV_LINE_SENSORS || size <= 0) {
    return 0;
  }
  put(line == SV_LINE_BUS ? "B" : "C", 1);
  put_number((uint64_t)size, 4);
  put(data, (size_t)size);
  return size;
}

uint32_t sv_hal_inputs(void) { return inputs; }

void sv_hal_feed_watchdog(void) {
  fed_us = now_us;
  wind_up();
}

int32_t sv_hal_reset_cause(void) { return cause; }
