/* media: the media with names: those of core, and those of --media FILE behind them. */
#ifndef DIPOLED_MEDIA_H
#define DIPOLED_MEDIA_H

#include <stdbool.h>
#include <stddef.h>

#include "core/core.h"

enum { MEDIA_MAX = 256 }; /* most media of a file */

/* Reads a file, once, before the threads start. Each line has a name, then red, green or blue unless
 * all three are alike, then 1 to 8 layers from the top down, SIGMA_A,SIGMA_S,G,ETA[,THICKNESS_MM] each;
 * blanks divide them, # begins a comment. A medium's three lines follow each other and have as many
 * layers each. Returns false, and says why, if the file cannot be read or a line is wrong. */
bool media_read(const char *path, char *why, size_t why_bytes);

/* Returns the media and their number. */
const core_measured_medium *media_all(size_t *count);

/* Returns the medium with this name, or NULL if there is none. */
const core_measured_medium *media_named(const char *name);

#endif
