/* material: reads the numbers of a material from a file of MaterialX (.mtlx, by expat), of glTF (JSON,
 * by jansson) or of pbrt. */
#ifndef DIPOLE_CLI_MATERIAL_H
#define DIPOLE_CLI_MATERIAL_H

#include "clients/cli/cli.h"

enum { CLI_MATERIAL_MAX = 64, CLI_MATERIAL_BYTES = 64 };

/* The numbers of a material by the names of its parameters, linear. */
typedef struct cli_material {
  size_t count;
  struct {
    char name[CLI_MATERIAL_BYTES];
    size_t count; /* 1 or 3; 0: it is connected to a node */
    double values[3];
  } items[CLI_MATERIAL_MAX];
} cli_material;

/* Each reads the first element of a name with inputs, such as open_pbr_surface; the extensions of the
 * first material, or of an object that is nothing else, that has a certain one; and all parameters
 * behind "subsurface". "-" is standard input. They say what is wrong and return false. */
bool cli_material_read_mtlx(const char *file, const char *element, cli_material *of);
bool cli_material_read_gltf(const char *file, const char *extension, cli_material *of);
bool cli_material_read_pbrt(const char *file, cli_material *of);

/* Adds a parameter of 1 or 3 numbers, with blanks between them, unless there is one of that name. */
void cli_material_add(cli_material *of, const char *name, const char *numbers);

/* Returns the values of a parameter, and sets *count; NULL if there is none. */
const double *cli_material_find(const cli_material *of, const char *name, size_t *count);

#endif
