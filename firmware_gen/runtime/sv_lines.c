#include "sv_lines.h"

#include "sv_time.h"

#define SV_SEQ_DIGITS 10
#define SV_TIME_DIGITS 16
#define SV_RAW_DIGITS 10
#define SV_DRIFT_PART 100U     // the node's clock runs slower or faster than ours by no more than this part of it
#define SV_MEMORY_US 1000000U  // how long a difference of the clocks is remembered
#define SV_SHARE_SHIFT 17      // differences in the same 2^17 us count as one

void sv_lines_init(sv_lines* lines) {
  lines->nopen = -1;
  lines->emergency_stop = 0;
  for (int32_t i = 0; i < SV_MESSAGE_MAX; i++) {
    lines->channels[i].ndifference = 0;
  }
}

// what a line says

static int32_t sv_is_digit(uint8_t c) { return c >= '0' && c <= '9'; }

// Return a hexadecimal digit's value, -1: it is none.
static int32_t sv_hex(uint8_t c) {
  if (sv_is_digit(c)) {
    return c - '0';
  }
  const int32_t letter = (c | 0x20) - 'a';
  return letter >= 0 && letter < 6 ? 10 + letter : -1;
}

// What is left of a line to read.
typedef struct {
  const uint8_t* text;
  int32_t at;
  int32_t end;
} sv_rest;

static int32_t sv_skip(sv_rest* rest, uint8_t c) {
  const int32_t is = rest->at < rest->end && rest->text[rest->at] == c;
  rest->at += is;
  return is;
}

// Read 1..ndigit digits, the last behind a number up to `most`: => value, which wraps; return whether there were as
// many.
static int32_t sv_number(sv_rest* rest, int32_t ndigit, uint32_t most, uint32_t* value) {
  int32_t n = 0;
  *value = 0;
  while (n < ndigit && *value <= most && rest->at < rest->end && sv_is_digit(rest->text[rest->at])) {
    *value = 10U * *value + (uint32_t)(rest->text[rest->at] - '0');
    rest->at++;
    n++;
  }
  return n > 0;
}

// Read the next raw count: => count; return whether there was one.
static int32_t sv_count(sv_rest* rest, int32_t* count) {
  uint32_t value = 0;
  if (!sv_skip(rest, ',')) {
    return 0;
  }
  const int32_t negative = sv_skip(rest, '-');
  if (!sv_number(rest, SV_RAW_DIGITS, INT32_MAX / 10, &value)) {
    return 0;
  }
  *count = (int32_t)(negative ? 0U - value : value);
  return value <= (uint32_t)INT32_MAX + (uint32_t)negative;
}

// Return whether a line is whole: it ends with * and the check of what is before it.
static int32_t sv_is_checked(const uint8_t* line, int32_t n) {
  if (n < 4 || line[n - 3] != '*' || sv_hex(line[n - 2]) < 0 || sv_hex(line[n - 1]) < 0) {
    return 0;
  }
  int32_t check = 0;
  for (int32_t i = 0; i < n - 3; i++) {
    check ^= line[i];
  }
  return check == sv_hex(line[n - 2]) * 16 + sv_hex(line[n - 1]);
}

// E, or E and a comma and anything that can be printed.
static int32_t sv_is_stop(const uint8_t* body, int32_t n) {
  for (int32_t i = 2; i < n; i++) {
    if (body[i] < ' ' || body[i] > '~' || body[i] == '*') {
      return 0;
    }
  }
  return body[0] == 'E' && (n == 1 || body[1] == ',');
}

// when its sample was taken

// Keep a difference that is seen now, and of those before it the smaller ones of the last second: the others tell
// nothing any more.
static void sv_see(sv_channel* channel, uint32_t offset_us, uint32_t now_us) {
  sv_difference* kept = channel->differences;
  int32_t n = 0;
  for (int32_t i = 0; i < channel->ndifference; i++) {
    if (now_us - kept[i].seen_us <= SV_MEMORY_US && (int32_t)(kept[i].offset_us - offset_us) < 0) {
      kept[n++] = kept[i];
    }
  }
  const int32_t shared = n > 0 && kept[n - 1].seen_us >> SV_SHARE_SHIFT == now_us >> SV_SHARE_SHIFT;
  if (n < SV_WINDOW_MAX && !shared) {
    kept[n++].offset_us = offset_us;
  }
  kept[n - 1].seen_us = now_us;
  channel->ndifference = n;
}

// Date a channel's new line; return whether it is another sample than the last.
static int32_t sv_date(sv_channel* channel, int32_t latency_us, uint32_t t_us, uint32_t now_us) {
  const int32_t starts = channel->ndifference == 0 || (int32_t)(t_us - channel->t_us) < 0;
  if (starts) {
    channel->ndifference = 0;
  } else if (t_us == channel->t_us) {
    return 0;
  }
  sv_see(channel, now_us - t_us - (uint32_t)latency_us, now_us);
  // a larger one than all of the last second's can only come of clocks that drift apart
  const uint32_t most_us = channel->offset_us + (now_us - channel->updated_us) / SV_DRIFT_PART;
  const uint32_t least_us = channel->differences[0].offset_us;
  channel->offset_us = starts || (int32_t)(least_us - most_us) < 0 ? least_us : most_us;
  channel->t_us = t_us;
  channel->updated_us = now_us;
  return 1;
}

// Hold the counts of a line for its sensors: => raw.
static void sv_hold(const sv_rig* rig, int32_t message, sv_rest rest, int32_t* raw) {
  int32_t count = 0;
  for (int32_t field = 0; sv_count(&rest, &count); field++) {
    for (int32_t i = 0; i < rig->nsensor; i++) {
      if (rig->sensors[i].message == message && rig->sensors[i].field == field) {
        raw[i] = count;
      }
    }
  }
}

// Take a whole line, from behind its $ to before its end.
static void sv_take_line(sv_lines* lines, const sv_rig* rig, uint32_t now_us, int32_t* raw) {
  const uint8_t* line = lines->open;
  if (!sv_is_checked(line, lines->nopen)) {
    return;
  }
  sv_rest rest = {line, 1, lines->nopen - 3};
  if (sv_is_stop(line, rest.end)) {
    lines->emergency_stop = 1;
    return;
  }
  uint32_t t_us = 0;
  if (!sv_skip(&rest, ',') || !sv_number(&rest, SV_SEQ_DIGITS, UINT32_MAX, &t_us) || !sv_skip(&rest, ',') ||
      !sv_number(&rest, SV_TIME_DIGITS, UINT32_MAX, &t_us)) {
    return;
  }
  const sv_rest counts = rest;
  int32_t ncount = 0;
  for (int32_t count = 0; sv_count(&rest, &count);) {
    ncount++;
  }
  for (int32_t i = 0; i < rig->nmessage && rest.at == rest.end; i++) {
    const sv_message* message = rig->messages + i;
    if (message->letter == line[0] && ncount >= message->width &&
        sv_date(lines->channels + i, message->latency_us, t_us, now_us)) {
      sv_hold(rig, i, counts, raw);
    }
  }
}

void sv_lines_feed(sv_lines* lines, const sv_rig* rig, const uint8_t* bytes, int32_t n, uint32_t now_us, int32_t* raw) {
  for (int32_t i = 0; i < n; i++) {
    if (bytes[i] == '$') {
      lines->nopen = 0;
    } else if (bytes[i] == '\r' || bytes[i] == '\n') {
      sv_take_line(lines, rig, now_us, raw);
      lines->nopen = -1;
    } else if (lines->nopen >= SV_LINE_BYTES_MAX) {
      lines->nopen = -1;
    } else if (lines->nopen >= 0) {
      lines->open[lines->nopen++] = bytes[i];
    }
  }
}

int32_t sv_lines_age_us(const sv_lines* lines, const sv_rig* rig, int32_t sensor, uint32_t now_us) {
  const sv_channel* channel = lines->channels + rig->sensors[sensor].message;
  return channel->ndifference > 0 ? sv_age_us(now_us, channel->t_us + channel->offset_us) : -1;
}
