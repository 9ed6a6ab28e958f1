/* Optical depth of rays through a CT volume in Hounsfield units, and through the body around it. */
#include <math.h>
#include <stddef.h>

typedef struct {
  int size[3];            /* voxels along the volume's axes; the last runs fastest */
  double to_index[12];    /* 3 x 4 row-major, place (m) to index */
  const short* values;    /* Hounsfield units */
  double water;           /* 1/m, attenuation of water */
  double bone;            /* how much more an excess over water counts, of bone over that of water */
  double step;            /* m between samples */
  double body_centre[3];  /* m, of an ellipsoid of soft tissue that is taken to lie outside the volume */
  double body_axes[3];    /* m, its semi-axes; zero: there is none */
  double body;            /* 1/m */
} CTVolume;

static double value_at(const CTVolume* ct, const double index[3]) {
  int base[3];
  double t[3];
  for (int k = 0; k < 3; k++) {
    const double limit = ct->size[k] - 1.000001, u = index[k] < 0 ? 0 : index[k] > limit ? limit : index[k];
    base[k] = (int)u;
    t[k] = u - base[k];
  }
  const size_t sy = ct->size[2], sx = (size_t)ct->size[1] * ct->size[2];
  const short* c = ct->values + base[0] * sx + base[1] * sy + base[2];
  const double c00 = c[0] + t[2] * (c[1] - c[0]), c01 = c[sy] + t[2] * (c[sy + 1] - c[sy]);
  const double c10 = c[sx] + t[2] * (c[sx + 1] - c[sx]), c11 = c[sx + sy] + t[2] * (c[sx + sy + 1] - c[sx + sy]);
  const double c0 = c00 + t[1] * (c01 - c00), c1 = c10 + t[1] * (c11 - c10);
  return c0 + t[0] * (c1 - c0);
}

/* Where a ray is in the volume's box, as an interval of its length (m); empty where it misses it. */
static void in_box(const CTVolume* ct, const double at[3], const double slope[3], double* near, double* far) {
  *near = 0, *far = HUGE_VAL;
  for (int k = 0; k < 3; k++) {
    const double low = -0.5, high = ct->size[k] - 0.5;
    if (fabs(slope[k]) < 1e-12) {
      if (at[k] < low || at[k] > high) *far = -1;
      continue;
    }
    const double a = (low - at[k]) / slope[k], b = (high - at[k]) / slope[k];
    *near = fmax(*near, fmin(a, b));
    *far = fmin(*far, fmax(a, b));
  }
  if (!(*near < *far)) *near = *far = 0;
}

static void in_body(const CTVolume* ct, const double start[3], const double direction[3], double* near, double* far) {
  double a = 0, b = 0, c = -1;
  *near = *far = 0;
  for (int k = 0; k < 3; k++) {
    if (!(ct->body_axes[k] > 0)) return;
    const double s = (start[k] - ct->body_centre[k]) / ct->body_axes[k], d = direction[k] / ct->body_axes[k];
    a += d * d, b += s * d, c += s * s;
  }
  const double root = b * b - a * c;
  if (root <= 0) return;
  *near = fmax((-b - sqrt(root)) / a, 0);
  *far = fmax((-b + sqrt(root)) / a, 0);
}

/* Optical depths of n rays from one start (m) along unit directions (n x 3). */
void cathsim_fluoroscopy_ct(const CTVolume* ct, const double start[3], long n, const double* directions, double* depths) {
  double at[3];
  for (int k = 0; k < 3; k++) {
    const double* m = ct->to_index + 4 * k;
    at[k] = m[0] * start[0] + m[1] * start[1] + m[2] * start[2] + m[3];
  }
  for (long i = 0; i < n; i++) {
    const double* d = directions + 3 * i;
    double slope[3], near, far, first, last, depth = 0;
    for (int k = 0; k < 3; k++) {
      const double* m = ct->to_index + 4 * k;
      slope[k] = m[0] * d[0] + m[1] * d[1] + m[2] * d[2];
    }
    in_box(ct, at, slope, &near, &far);
    const int steps = (int)ceil((far - near) / ct->step);
    const double length = steps > 0 ? (far - near) / steps : 0;
    for (int s = 0; s < steps; s++) {
      const double t = near + (s + 0.5) * length;
      const double index[3] = {at[0] + t * slope[0], at[1] + t * slope[1], at[2] + t * slope[2]};
      const double excess = value_at(ct, index) / 1000;
      const double share = 1 + (excess > 0 ? ct->bone * excess : excess);
      if (share > 0) depth += length * ct->water * share;
    }
    in_body(ct, start, d, &first, &last);
    const double overlap = fmin(far, last) - fmax(near, first);
    depth += ct->body * (last - first - (overlap > 0 ? overlap : 0));
    depths[i] = depth;
  }
}
