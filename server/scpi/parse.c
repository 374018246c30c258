#include "server/scpi/parse.h"

#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "proto/decimal.h"
#include "server/scpi/status.h"

static bool is_blank(char byte) {
  return (byte >= 0 && byte <= ' ') && byte != '\n';
}

static bool is_digit(char byte) {
  return byte >= '0' && byte <= '9';
}

/* ---- messages and units ---------------------------------------------------------------------- */

/* Follows a byte outside strings: `#` behind a blank or a comma, a digit, and so many digits. */
static void follow_block(struct scpi_scan *scan, char byte) {
  if (scan->digits > 0 && is_digit(byte)) {
    scan->length = 10 * scan->length + (uint64_t)(byte - '0');
    if (--scan->digits == 0 && scan->length <= SCPI_BLOCK_MAX_BYTES) {
      scan->skip = scan->length;
    }
    scan->before = byte;
    return;
  }
  const bool begins = scan->before == '#' && is_digit(byte);
  scan->digits = begins ? (unsigned)(byte - '0') : 0;
  scan->length = 0;
  /* '#' stands for one that can begin a block */
  scan->before = byte == '#' && scan->before != ' ' ? 'x'
                 : is_blank(byte) || byte == ','    ? ' '
                                                    : byte;
}

bool scpi_scan(struct scpi_scan *scan, const char *bytes, size_t count, char end) {
  while (scan->at < count) {
    if (scan->skip > 0) {
      const size_t left = count - scan->at;
      const size_t skipped = scan->skip < left ? (size_t)scan->skip : left;
      scan->at += skipped;
      scan->skip -= skipped;
      continue;
    }
    const char byte = bytes[scan->at++];
    if (byte == end && (end == '\n' || scan->quote == 0)) {
      *scan = (struct scpi_scan){.at = scan->at};
      return true;
    }
    if (scan->quote != 0) {
      scan->quote = byte == scan->quote ? 0 : scan->quote;
    } else if (byte == '"' || byte == '\'') {
      scan->quote = byte;
    } else {
      follow_block(scan, byte);
    }
  }
  return false;
}

static void skip_blanks(const char **at, const char *end) {
  while (*at < end && is_blank(**at)) {
    ++*at;
  }
}

int scpi_next_unit(const char *message, size_t count, size_t *at, struct scpi_unit *unit) {
  struct scpi_scan scan = {.at = *at};
  const char *from, *end;
  do { /* units without a byte mean nothing */
    from = message + scan.at;
    end = message + (scpi_scan(&scan, message, count, ';') ? scan.at - 1 : count);
    skip_blanks(&from, end);
  } while (from == end && scan.at < count);
  *at = scan.at;
  *unit = (struct scpi_unit){.rooted = from < end && (*from == ':' || *from == '*'), .end = end};
  const char *begin = from;
  from += from < end && *from == ':';
  unit->header = from;
  for (; from < end && !is_blank(*from); from++) {
    if (!isalnum((unsigned char)*from) && strchr(":*_?", *from) == NULL) {
      return SCPI_UNDEFINED_CHARACTER;
    }
  }
  unit->header_bytes = (size_t)(from - unit->header);
  if (unit->header_bytes == 0 && begin < end) {
    return SCPI_UNDEFINED_CHARACTER;
  }
  unit->query = unit->header_bytes > 1 && from[-1] == '?';
  unit->header_bytes -= unit->query;
  skip_blanks(&from, end);
  unit->at = from;
  return 0;
}

/* ---- parameters ------------------------------------------------------------------------------ */

/* Takes the text of a string up to its mark. */
static int take_string(struct scpi_unit *unit, struct scpi_parameter *parameter) {
  const char mark = *unit->at++;
  const char *close = memchr(unit->at, mark, (size_t)(unit->end - unit->at));
  if (close == NULL) {
    return SCPI_BAD_STRING;
  }
  *parameter = (struct scpi_parameter){SCPI_STRING, unit->at, (size_t)(close - unit->at)};
  unit->at = close + 1;
  return 0;
}

/* Takes #, the number of digits of its length, the length, and so many bytes. */
static int take_block(struct scpi_unit *unit, struct scpi_parameter *parameter) {
  const char *at = unit->at + 1;
  uint64_t length = 0;
  unsigned digits = at < unit->end && is_digit(*at) ? (unsigned)(*at++ - '0') : 0;
  if (digits == 0) {
    return at < unit->end && isalpha((unsigned char)*at) ? SCPI_BAD_TYPE : SCPI_BAD_BLOCK;
  }
  for (; digits > 0 && at < unit->end && is_digit(*at); digits--) {
    length = 10 * length + (uint64_t)(*at++ - '0');
  }
  if (digits > 0 || length > (uint64_t)(unit->end - at)) {
    return SCPI_BAD_BLOCK;
  }
  *parameter = (struct scpi_parameter){SCPI_BLOCK, at, (size_t)length};
  unit->at = at + length;
  return 0;
}

static int take_plain(struct scpi_unit *unit, struct scpi_parameter *parameter) {
  static const char of_words[] = "_-.", of_decimals[] = "+-.eE";
  const bool word = isalpha((unsigned char)*unit->at);
  const char *from = unit->at;
  while (unit->at < unit->end &&
         (is_digit(*unit->at) || (word && isalpha((unsigned char)*unit->at)) ||
          (*unit->at != '\0' && strchr(word ? of_words : of_decimals, *unit->at) != NULL))) {
    unit->at++;
  }
  *parameter =
      (struct scpi_parameter){word ? SCPI_WORD : SCPI_DECIMAL, from, (size_t)(unit->at - from)};
  return unit->at > from ? 0 : SCPI_UNDEFINED_CHARACTER;
}

int scpi_next_parameter(struct scpi_unit *unit, struct scpi_parameter *parameter) {
  *parameter = (struct scpi_parameter){SCPI_NOTHING};
  skip_blanks(&unit->at, unit->end);
  if (unit->at == unit->end) {
    return unit->more ? SCPI_MISSING : 0;
  }
  const int error = *unit->at == '"' || *unit->at == '\'' ? take_string(unit, parameter)
                    : *unit->at == '#'                    ? take_block(unit, parameter)
                    : *unit->at == ','                    ? SCPI_MISSING
                                                          : take_plain(unit, parameter);
  skip_blanks(&unit->at, unit->end);
  unit->more = unit->at < unit->end && *unit->at == ',';
  if (error == 0 && unit->at < unit->end && !unit->more) {
    return parameter->kind == SCPI_DECIMAL && isalpha((unsigned char)*unit->at)
               ? SCPI_BAD_SUFFIX
               : SCPI_BAD_SEPARATOR;
  }
  unit->at += unit->more;
  return error;
}

int scpi_read_decimal(const struct scpi_parameter *parameter, double *value) {
  char text[300], *end; /* 255 digits, which IEEE 488.2 allows, and their exponent */
  if (parameter->kind != SCPI_DECIMAL || parameter->bytes >= sizeof text) {
    return parameter->kind != SCPI_DECIMAL ? SCPI_BAD_TYPE : SCPI_TOO_MANY_DIGITS;
  }
  memcpy(text, parameter->text, parameter->bytes);
  text[parameter->bytes] = '\0';
  const char *exponent = strpbrk(text, "eE");
  if (exponent != NULL && labs(strtol(exponent + 1, NULL, 10)) > 32000) {
    return SCPI_BIG_EXPONENT;
  }
  return decimal_read(text, value)                   ? 0
         : isinf(strtod(text, &end)) && *end == '\0' ? SCPI_OUT_OF_RANGE
                                                     : SCPI_BAD_DECIMAL;
}

/* ---- headers --------------------------------------------------------------------------------- */

bool scpi_is_word(const char *text, size_t bytes, const char *word, size_t word_bytes) {
  size_t capitals = 0;
  while (capitals < word_bytes && !islower((unsigned char)word[capitals])) {
    capitals++;
  }
  return (bytes == word_bytes || bytes == capitals) && strncasecmp(text, word, bytes) == 0;
}

bool scpi_matches(const char *pattern, const char *header, size_t bytes, unsigned *number) {
  if (*pattern == '[') {
    return scpi_matches(pattern + 1, header, bytes, number) ||
           scpi_matches(strchr(pattern, ']') + 1, header, bytes, number);
  }
  if (*pattern == ']') {
    return scpi_matches(pattern + 1, header, bytes, number);
  }
  if (*pattern == ':') {
    return bytes > 0 && *header == ':' && scpi_matches(pattern + 1, header + 1, bytes - 1, number);
  }
  if (*pattern == '\0') {
    return bytes == 0;
  }
  const size_t word = strcspn(pattern, "[]:<");
  const char *colon = memchr(header, ':', bytes);
  const size_t node = colon != NULL ? (size_t)(colon - header) : bytes;
  size_t letters = node;
  if (pattern[word] == '<') {
    *number = 0;
    while (letters > 0 && is_digit(header[letters - 1])) {
      letters--;
    }
    for (size_t i = letters; i < node && i < letters + 3; i++) {
      *number = 10 * *number + (unsigned)(header[i] - '0');
    }
    *number = letters == node ? 1 : *number;
  }
  return scpi_is_word(header, letters, pattern, word) &&
         scpi_matches(pattern + word + (pattern[word] == '<' ? strlen("<n>") : 0), header + node,
                      bytes - node, number);
}
