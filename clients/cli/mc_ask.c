/* What `dipole mc` asks the daemon. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "clients/cli/mc.h"

#define G_DEFAULT 0.0
#define ETA_DEFAULT 1.3
#define FROM_DEFAULT_MM 0.0
#define TO_DEFAULT_MM 10.0
#define RINGS_DEFAULT 20
#define PHOTONS_DEFAULT 1000000
#define SEED_DEFAULT 1
#define PHOTONS_LIMIT "max_mc_photons"

enum { MEASURED_CHANNELS = 3 };

static const char *const colours[MEASURED_CHANNELS] = {"red", "green", "blue"};

/* ---- without a daemon ---------------------------------------------------------------------- */

static int check_medium(const cli_command *command, const cli_mc_settings *settings) {
  const bool coefficients = settings->sigma_a.given || settings->sigma_s.given;
  if (settings->medium == NULL) {
    if (!settings->sigma_a.given || !settings->sigma_s.given) {
      return cli_fail_usage(command, "give --medium NAME and --channel, or --sigma-a and "
                                     "--sigma-s");
    }
    return settings->channel == NULL ? CLI_OK
                                     : cli_fail_usage(command, "--channel goes with --medium NAME");
  }
  if (coefficients) {
    return cli_fail_usage(command, "--medium NAME stands for --sigma-a and --sigma-s: leave these "
                                   "out; --g and --eta may stay");
  }
  for (size_t i = 0; settings->channel != NULL && i < MEASURED_CHANNELS; i++) {
    if (strcmp(settings->channel, colours[i]) == 0) {
      return CLI_OK;
    }
  }
  return cli_fail_usage(command, "--medium NAME needs --channel red, green or blue");
}

int cli_mc_check(const cli_command *command, const cli_mc_settings *settings) {
  const int status = check_medium(command, settings);
  if (status != CLI_OK) {
    return status;
  }
  if (settings->logarithmic && !settings->from.given) {
    return cli_fail_usage(command, "--log needs --from, above 0");
  }
  if (settings->rings.value > UINT32_MAX) {
    return cli_fail_usage(command, "--rings: at most %lu", (unsigned long)UINT32_MAX);
  }
  const double photons = settings->photons.value;
  if (settings->photons.given &&
      !(photons >= 1 && photons <= 0x1p53 && photons == floor(photons))) {
    return cli_fail_usage(command, "--photons: a whole number, such as 2000000 or 2e6");
  }
  if (settings->albedo.count > UINT16_MAX) {
    return cli_fail_usage(command, "--albedo: at most %d", UINT16_MAX);
  }
  return CLI_OK;
}

/* ---- the medium ---------------------------------------------------------------------------- */

static double or_else(const cli_number *number, double otherwise) {
  return number->given ? number->value : otherwise;
}

static const dipole_measured_medium *find_medium(const cli_command *command, const char *name,
                                                 const dipole_measured_medium *media,
                                                 size_t count) {
  char known[1024] = "";
  size_t length = 0;
  for (size_t i = 0; i < count; i++) {
    if (strcmp(media[i].name, name) == 0) {
      return &media[i];
    }
    if (length < sizeof known) {
      length += (size_t)snprintf(known + length, sizeof known - length, "%s%s", i > 0 ? ", " : "",
                                 media[i].name);
    }
  }
  cli_fail_usage(command, "--medium: '%s' is unknown; this daemon has %s", name, known);
  return NULL;
}

/* Only sigma_s' was measured: with another g, sigma_s is what gives the same sigma_s'. */
static void with_g(dipole_medium *medium, double g) {
  medium->sigma_s_per_mm = medium->sigma_s_per_mm * (1 - medium->g) / (1 - g);
  medium->g = g;
}

static int measured(const cli_command *command, const cli_mc_settings *settings,
                    dipole_client *client, dipole_medium *medium) {
  dipole_measured_medium *media;
  dipole_error error;
  size_t count, colour = 0;
  if (!dipole_media(client, &media, &count, &error)) {
    return cli_fail(command, "%s", error.text);
  }
  const dipole_measured_medium *found = find_medium(command, settings->medium, media, count);
  if (found == NULL) {
    free(media);
    return CLI_USAGE;
  }
  while (strcmp(settings->channel, colours[colour]) != 0) {
    colour++;
  }
  *medium = found->channel[colour];
  free(media);
  if (settings->g.given) {
    with_g(medium, settings->g.value);
  }
  medium->eta = or_else(&settings->eta, medium->eta);
  return CLI_OK;
}

/* ---- the query ----------------------------------------------------------------------------- */

/* Errors are what counts where they are asked for: then photons are limited by the daemon alone. */
static uint64_t photons_of(const cli_mc_settings *settings, const dipole_info *info) {
  if (settings->photons.given) {
    return (uint64_t)settings->photons.value;
  }
  for (size_t i = 0; i < info->limit_count; i++) {
    if ((settings->error.given || settings->total_error.given) &&
        strcmp(info->limits[i].name, PHOTONS_LIMIT) == 0) {
      return info->limits[i].value;
    }
  }
  return PHOTONS_DEFAULT;
}

int cli_mc_query(const cli_command *command, const cli_mc_settings *settings, dipole_client *client,
                 cli_mc_report *report) {
  report->info = dipole_get_info(client);
  report->medium = settings->medium;
  report->channel = settings->channel;
  report->query = (dipole_mc_query){
      .medium = {settings->sigma_a.value, settings->sigma_s.value, or_else(&settings->g, G_DEFAULT),
                 or_else(&settings->eta, ETA_DEFAULT)},
      .albedos = settings->albedo.items,
      .albedo_count = (unsigned)settings->albedo.count,
      .thickness_mm = or_else(&settings->thickness, (double)INFINITY),
      .spacing = settings->logarithmic ? DIPOLE_LOGARITHMIC : DIPOLE_LINEAR,
      .ring_count = settings->rings.given ? (uint32_t)settings->rings.value : RINGS_DEFAULT,
      .radius_start_mm = or_else(&settings->from, FROM_DEFAULT_MM),
      .radius_stop_mm = or_else(&settings->to, TO_DEFAULT_MM),
      .seed = settings->seed.given ? settings->seed.value : SEED_DEFAULT,
      .photons = photons_of(settings, report->info),
      .error_total = settings->total_error.value,
      .error_rings = settings->error.value,
  };
  return settings->medium == NULL ? CLI_OK
                                  : measured(command, settings, client, &report->query.medium);
}
