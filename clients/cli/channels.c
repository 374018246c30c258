/* The media that --medium or --sigma-a, --sigma-s, --g and --eta describe. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/channels.h"

#define G_DEFAULT 0.0
#define ETA_DEFAULT 1.3

static const char *const colours[] = {"red", "green", "blue"};

enum { COLOURS = sizeof colours / sizeof colours[0] };

bool cli_channels_given(const cli_medium_settings *settings) {
  return settings->medium != NULL || settings->channel.count > 0 || settings->sigma_a.count > 0 ||
         settings->sigma_s.count > 0 || settings->g.count > 0 || settings->eta.count > 0;
}

static bool is_listed(const cli_texts *names, const char *name) {
  for (size_t i = 0; i < names->count; i++) {
    if (strcmp(names->items[i], name) == 0) {
      return true;
    }
  }
  return false;
}

/* Whether a colour of a measured medium is asked for: each is, where none is named. */
static bool is_asked(const cli_medium_settings *settings, size_t colour) {
  return settings->channel.count == 0 || is_listed(&settings->channel, colours[colour]);
}

static bool is_colour(const char *name) {
  size_t i = 0;
  while (i < COLOURS && strcmp(colours[i], name) != 0) {
    i++;
  }
  return i < COLOURS;
}

static int check_colours(const cli_command *command, const cli_texts *names) {
  for (size_t i = 0; i < names->count; i++) {
    if (!is_colour(names->items[i])) {
      return cli_fail_usage(command, "--channel: '%s' is unknown; it is red, green or blue",
                            names->items[i]);
    }
  }
  return CLI_OK;
}

int cli_channels_check(const cli_command *command, const cli_medium_settings *settings) {
  const bool coefficients = settings->sigma_a.count > 0 || settings->sigma_s.count > 0;
  if (settings->medium == NULL && (settings->sigma_a.count == 0 || settings->sigma_s.count == 0)) {
    return cli_fail_usage(command, "give --medium NAME, or --sigma-a and --sigma-s");
  }
  if (settings->medium != NULL && (coefficients || settings->g.count > 0)) {
    return cli_fail_usage(command, "--medium NAME stands for --sigma-a, --sigma-s and --g: leave "
                                   "these out; --eta may stay");
  }
  if (settings->medium == NULL && settings->channel.count > 0) {
    return cli_fail_usage(command, "--channel is one of a measured medium: give --medium too");
  }
  return check_colours(command, &settings->channel);
}

static const dipole_measured_medium *find_medium(const dipole_measured_medium *media, size_t count,
                                                 const char *name) {
  for (size_t i = 0; i < count; i++) {
    if (strcmp(media[i].name, name) == 0) {
      return &media[i];
    }
  }
  return NULL;
}

static int fail_unknown(const cli_command *command, const char *name,
                        const dipole_measured_medium *media, size_t count) {
  char known[1024] = "";
  size_t length = 0;
  for (size_t i = 0; i < count && length < sizeof known; i++) {
    length += (size_t)snprintf(known + length, sizeof known - length, "%s%s", i > 0 ? ", " : "",
                               media[i].name);
  }
  return cli_fail_usage(command, "--medium: '%s' is unknown; this daemon has %s", name, known);
}

/* Value number `channel` of an option that has one value for all channels or one for each. */
static double pick(const cli_numbers *numbers, size_t channel, double otherwise) {
  return numbers->count == 0 ? otherwise : numbers->items[numbers->count == 1 ? 0 : channel];
}

/* The first of some names that are separated by commas, as a text; what follows it, or NULL. */
static const char *take_name(const char *names, char *name, size_t bytes) {
  const size_t length = strcspn(names, ",");
  snprintf(name, bytes, "%.*s", (int)length, names);
  return names[length] == ',' ? names + length + 1 : NULL;
}

/* The channels of a medium that are asked for; several: named after it too. */
static void add_measured(const cli_medium_settings *settings, const dipole_measured_medium *medium,
                         bool several, cli_channels *channels) {
  channels->items = cli_resize(channels->items, channels->count + COLOURS, sizeof *channels->items);
  for (size_t i = 0; i < COLOURS; i++) {
    if (is_asked(settings, i)) {
      cli_channel *channel = &channels->items[channels->count];
      snprintf(channel->name, sizeof channel->name, "%s%s%s", several ? medium->name : "",
               several ? " " : "", colours[i]);
      channel->medium = medium->channel[i];
      channel->medium.eta = pick(&settings->eta, channels->count, channel->medium.eta);
      channels->count++;
    }
  }
}

static int measured(const cli_command *command, const cli_medium_settings *settings,
                    dipole_client *client, cli_channels *channels) {
  const bool several = strchr(settings->medium, ',') != NULL;
  dipole_measured_medium *media;
  dipole_error error;
  size_t count;
  int status = CLI_OK;
  char name[64];
  if (!dipole_media(client, &media, &count, &error)) {
    return cli_fail(command, "%s", error.text);
  }
  for (const char *names = settings->medium; status == CLI_OK && names != NULL;) {
    names = take_name(names, name, sizeof name);
    const dipole_measured_medium *medium = find_medium(media, count, name);
    if (medium != NULL) {
      add_measured(settings, medium, several, channels);
    } else {
      status = fail_unknown(command, name, media, count);
    }
  }
  channels->medium = settings->medium;
  if (status != CLI_OK) {
    free(channels->items);
    channels->items = NULL;
  }
  free(media);
  return status;
}

static void given(const cli_medium_settings *settings, size_t count, cli_channels *channels) {
  channels->count = count;
  channels->items = cli_allocate(count, sizeof *channels->items);
  for (size_t i = 0; i < count; i++) {
    cli_channel *channel = &channels->items[i];
    snprintf(channel->name, sizeof channel->name, "%zu", i + 1);
    channel->medium = (dipole_medium){.sigma_a_per_mm = pick(&settings->sigma_a, i, 0),
                                      .sigma_s_per_mm = pick(&settings->sigma_s, i, 0),
                                      .g = pick(&settings->g, i, G_DEFAULT),
                                      .eta = pick(&settings->eta, i, ETA_DEFAULT)};
  }
}

static size_t count_measured(const cli_medium_settings *settings) {
  size_t media = 1, asked = 0;
  for (const char *comma = settings->medium; (comma = strchr(comma, ',')) != NULL; comma++) {
    media++;
  }
  for (size_t i = 0; i < COLOURS; i++) {
    asked += is_asked(settings, i);
  }
  return media * asked;
}

/* The number of channels: that of the options with more than one value, which must agree. */
static bool count_channels(const cli_command *command, const cli_medium_settings *settings,
                           size_t *count) {
  const struct {
    const char *name;
    const cli_numbers *numbers;
  } options[] = {{"sigma-a", &settings->sigma_a},
                 {"sigma-s", &settings->sigma_s},
                 {"g", &settings->g},
                 {"eta", &settings->eta}};
  const char *first = NULL;
  *count = 1;
  if (settings->medium != NULL) {
    first = "medium";
    *count = count_measured(settings);
  }
  for (size_t i = 0; i < sizeof options / sizeof options[0]; i++) {
    const size_t values = options[i].numbers->count;
    if (values > 1 && first != NULL && values != *count) {
      cli_fail_usage(command, "--%s has %zu values and --%s has %zu: give one value or as many",
                     options[i].name, values, first, *count);
      return false;
    }
    if (values > 1 && first == NULL) {
      first = options[i].name;
      *count = values;
    }
  }
  return true;
}

int cli_channels_take(const cli_command *command, const cli_medium_settings *settings,
                      dipole_client *client, cli_channels *channels) {
  size_t count;
  if (!count_channels(command, settings, &count)) {
    return CLI_USAGE;
  }
  if (settings->medium != NULL) {
    return measured(command, settings, client, channels);
  }
  given(settings, count, channels);
  return CLI_OK;
}
