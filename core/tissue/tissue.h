/* tissue: the medium that a tissue is at a wavelength, from what it is made of.
 *
 *   sigma_a = sum of amount times absorption per amount (Jacques 2013, Phys. Med. Biol. 58, R37,
 *             Eq. 12), where that of haemoglobin is less in vessels: core_tissue_packaging()
 *   sigma_s (1 - g) = a (f (lambda / 500)^-4 + (1 - f) (lambda / 500)^-b) (Eqs. 1, 2), f the
 *             property `rayleigh_share`, lambda in nm
 *
 * tissue.def lists the properties and what their units are, spectra.def the absorption. A spectrum is
 * linear between its points, and nothing is said beyond its ends. The result has the same bits on
 * every machine. The functions are pure. */
#ifndef DIPOLED_CORE_TISSUE_H
#define DIPOLED_CORE_TISSUE_H

#include "core/core.h"
#include "core/tissue/tissue.def"

/* Ids from 1 to CORE_CHROMOPHORES_MAX are amounts of chromophores; others are not. */
enum core_property {
  CORE_EACH_PROPERTY(CORE_ENUM, CORE_PROPERTY) CORE_PROPERTIES_END,
  CORE_CHROMOPHORES_MAX = 31
};

enum core_haemoglobin { CORE_EACH_HAEMOGLOBIN(CORE_ENUM, CORE_HAEMOGLOBIN) };

/* The wavelengths in nm of the scattering law, "good from 400 to 1300 nm" (Jacques 2013, p. R42). */
#define CORE_SCATTERING_FROM_NM 400
#define CORE_SCATTERING_TO_NM 1300

enum { CORE_TISSUE_WAVELENGTHS_MAX = 1024 }; /* of one request */

/* What a tissue is, of the lists in core.h: value[CORE_PROPERTY_...]. */
typedef struct core_tissue {
  double value[CORE_PROPERTIES_END];
  enum core_haemoglobin haemoglobin;
} core_tissue;

/* Returns the tissue of core_tissues with this id, or, for 0, one whose properties are the usual
 * ones; by Prahl's haemoglobin. a_per_mm and b are NaN where they have to be given. */
core_tissue core_tissue_named(unsigned id);

/* Returns the first fault of a tissue: a property that is outside its range or has to be given, in
 * the order of the list, or vessels with whole blood. */
core_fault core_tissue_check(const core_tissue *tissue);

/* Sets *medium to one layer of the tissue at a wavelength. Returns the fault of core_tissue_check();
 * else one of the field "wavelength" if a spectrum of which there is an amount, or the scattering
 * law, unless a is 0, is not known there; else of core_medium_check(). With a fault, *medium stays. */
core_fault core_tissue_medium(const core_tissue *tissue, double wavelength_nm, core_medium *medium);

/* Sets *per_mm to the absorption of an amount of 1 (uM, or a share of the volume) of a chromophore, as a
 * coefficient of natural exponential decay in 1/mm. Returns a fault of the field "wavelength" outside
 * of its spectrum, whose range `allowed` names. Asserts that the ids are in their lists. */
core_fault core_chromophore_at(enum core_property chromophore, enum core_haemoglobin haemoglobin,
                               double wavelength_nm, double *per_mm);

/* Returns the factor by which vessels of a radius lessen the absorption of the blood in them:
 * (1 - e^-x) / x, x = 2 r mu (Svaasand et al. 1995; van Veen et al. 2002), mu that of whole blood of
 * CORE_BLOOD_UM haemoglobin with the saturation of hbo2_uM and hb_uM. 1 without haemoglobin or radius.
 * per_mm: of the two, per uM. */
#define CORE_BLOOD_UM 2326 /* 150 g/L of 64500 g/mol */
double core_tissue_packaging(const core_tissue *tissue, double hbo2_per_mm, double hb_per_mm);

/* Returns (1 - e^-x) / x for x from 0 on. */
double core_packaging_of(double x);

#endif
