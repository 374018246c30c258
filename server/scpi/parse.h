/* parse: the text of SCPI: where a message ends, its units, their headers and parameters. It knows no
 * command, and reads only the bytes that it is given. Errors are numbers of SCPI-99, 0 for none.
 *
 *   FORM REAL,64;BORD SWAP;:R? 0.5,1,2      one message, three units
 */
#ifndef DIPOLED_SCPI_PARSE_H
#define DIPOLED_SCPI_PARSE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Larger blocks are no blocks: the text of their first bytes ends at a newline. */
#define SCPI_BLOCK_MAX_BYTES UINT64_C(67108864)

/* Where a search is that goes on when more bytes have arrived. All members start as 0. */
struct scpi_scan {
  size_t at;          /* bytes before this one have been looked at */
  uint64_t skip;      /* bytes of a block that follow */
  uint64_t length;    /* of a block, as far as its digits have been read */
  unsigned digits;    /* of the length that follow */
  char before, quote; /* the byte before; the mark that ends a string, 0 outside */
};

/* Goes on to the next `end`: a newline outside blocks, or a ; or , outside blocks and strings. Returns
 * whether there is one; scan->at is then behind it, else `count`. */
bool scpi_scan(struct scpi_scan *scan, const char *bytes, size_t count, char end);

struct scpi_unit {
  const char *header;  /* without the ? of a query, and without a colon in front */
  size_t header_bytes; /* 0: the message has no further unit */
  bool rooted;         /* whether a colon stood in front, or it is a common command */
  bool query;
  unsigned number;      /* that the header has in place of <n> */
  const char *at, *end; /* its parameters that have not been taken */
  bool more;            /* whether a comma stood before `at` */
};

/* Takes the unit of a message that begins at *at, and moves *at behind it. */
int scpi_next_unit(const char *message, size_t count, size_t *at, struct scpi_unit *unit);

enum scpi_kind { SCPI_NOTHING, SCPI_WORD, SCPI_DECIMAL, SCPI_STRING, SCPI_BLOCK };
struct scpi_parameter {
  enum scpi_kind kind;
  const char *text; /* of strings and blocks: what is inside */
  size_t bytes;
};

/* Takes the next parameter of a unit; NOTHING: there is none. */
int scpi_next_parameter(struct scpi_unit *unit, struct scpi_parameter *parameter);

/* Reads a decimal parameter. */
int scpi_read_decimal(const struct scpi_parameter *parameter, double *value);

/* Returns whether a text is a word in its long or its short form, whose capitals the word begins
 * with; case does not matter. */
bool scpi_is_word(const char *text, size_t bytes, const char *word, size_t word_bytes);

/* Returns whether a header fits a pattern of proto/scpi.def. Sets *number to that of <n>. */
bool scpi_matches(const char *pattern, const char *header, size_t bytes, unsigned *number);

#endif
