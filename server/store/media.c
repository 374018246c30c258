#include "server/store/media.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "proto/decimal.h"
#include "server/options.h"

enum { RED = 1, ALL = 7 };

static core_measured_medium *own; /* those of core and of the file; NULL without a file */
static size_t own_count;

const core_measured_medium *media_all(size_t *count) {
  *count = own != NULL ? own_count : core_measured_media_count;
  return own != NULL ? own : core_measured_media;
}

const core_measured_medium *media_named(const char *name) {
  size_t count;
  const core_measured_medium *all = media_all(&count);
  for (size_t i = 0; i < count; i++) {
    if (all[i].name[0] == name[0] && strcmp(all[i].name, name) == 0) {
      return &all[i];
    }
  }
  return NULL;
}

static bool read_layer(char *text, core_medium *layer) {
  double numbers[5] = {0};
  size_t count = 0;
  for (char *one; (one = strsep(&text, ",")) != NULL; count++) {
    if (count == 5 || !decimal_read(one, &numbers[count])) {
      return false;
    }
  }
  *layer = (core_medium){numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]};
  return count >= 4;
}

/* Returns the bits of the channels that a word names; 0: it names none. */
static unsigned channels_of(const char *word) {
  static const char *const colours[] = {"red", "green", "blue"};
  unsigned bits = 0;
  for (unsigned i = 0; i < 3; i++) {
    bits |= word != NULL && strcmp(word, colours[i]) == 0 ? RED << i : 0;
  }
  return bits;
}

/* Finds the medium of a line, or begins it. *given: the bits of the channels that the last medium
 * has. Returns what is wrong, or NULL. */
static const char *find_medium(const char *name, unsigned channels, unsigned *given) {
  core_measured_medium *last = &own[own_count - 1];
  const bool goes_on = *given != ALL && strcmp(last->name, name) == 0;
  if (strlen(name) >= CORE_NAME_BYTES) {
    return "a name has at most 16 bytes";
  }
  if (*given != ALL && (!goes_on || (*given & channels) != 0)) {
    return "the medium above needs a line for red, green and blue each";
  }
  if (!goes_on) {
    if (media_named(name) != NULL) {
      return "the name is taken";
    }
    if (own_count == core_measured_media_count + MEDIA_MAX) {
      return "a file has at most 256 media";
    }
    *given = 0;
    last = &own[own_count++];
    *last = (core_measured_medium){.layer_count = 0};
    strcpy(last->name, name);
  }
  *given |= channels;
  return NULL;
}

/* Reads a line; the context is *given of find_medium(). Returns what is wrong, or NULL. */
static const char *read_line(void *context, char *line) {
  unsigned *given = context;
  static const char blanks[] = " \t\r\n",
                    form[] = "layers are SIGMA_A,SIGMA_S,G,ETA[,THICKNESS_MM]";
  core_medium layers[CORE_LAYERS_MAX];
  size_t count = 0;
  line[strcspn(line, "#")] = '\0';
  char *rest, *name = strtok_r(line, blanks, &rest);
  if (name == NULL) {
    return NULL;
  }
  char *word = strtok_r(NULL, blanks, &rest);
  const unsigned named = channels_of(word), channels = named != 0 ? named : ALL;
  for (word = named != 0 ? strtok_r(NULL, blanks, &rest) : word; word != NULL;
       word = strtok_r(NULL, blanks, &rest)) {
    if (count == CORE_LAYERS_MAX || !read_layer(word, &layers[count++])) {
      return form;
    }
  }
  const core_fault fault = core_layers_check(layers, count);
  if (count == 0 || fault.field != NULL) {
    return count == 0 ? form : fault.allowed;
  }
  const char *wrong = find_medium(name, channels, given);
  core_measured_medium *medium = &own[own_count - 1];
  if (wrong == NULL && medium->layer_count > 0 && medium->layer_count != count) {
    return "red, green and blue have as many layers each";
  }
  medium->layer_count = wrong == NULL ? count : medium->layer_count;
  for (unsigned i = 0; wrong == NULL && i < 3; i++) {
    if ((channels & RED << i) != 0) {
      memcpy(&medium->channel[i * count], layers, count * sizeof *layers);
    }
  }
  return wrong;
}

bool media_read(const char *path, char *why, size_t why_bytes) {
  unsigned given = ALL;
  own = calloc(core_measured_media_count + MEDIA_MAX, sizeof *own);
  if (own == NULL) {
    snprintf(why, why_bytes, "out of memory");
    return false;
  }
  own_count = core_measured_media_count;
  memcpy(own, core_measured_media, own_count * sizeof *own);
  if (!options_read_lines(path, read_line, &given, why, why_bytes)) {
    return false;
  }
  if (given != ALL) {
    snprintf(why, why_bytes, "the last medium lacks a colour");
  }
  return given == ALL;
}
