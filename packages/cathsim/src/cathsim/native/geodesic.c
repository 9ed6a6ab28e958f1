/* Fast marching: distance inside a lumen from seeds, second order in the spacing where two known nodes line up.
 *
 * Solves |grad T| = 1 with upwind differences, accepting nodes in the order of their distance (Sethian 1996). Outside
 * the lumen the distances are continued layer by layer. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "lattice.h"

#define BEFORE(a, b) ((a).value < (b).value)
#include "heap.h"

typedef struct {
  const NodeSet* set;
  const uint8_t* inside; /* whether each node lies in the lumen */
  const uint8_t* accepted;
  const double* distance; /* m */
  double inverse;         /* 1 / spacing */
} March;

static const int steps[3] = {NODE_X, NODE_Y, NODE_Z};

/* The distance at a node from its accepted neighbours. Along each axis the upwind difference is a T - b, with a in
 * 1/spacing; the squares add up to 1. */
static double solve(const March* m, int32_t node) {
  const uint8_t* accepted = m->accepted;
  const double *distance = m->distance, inverse = m->inverse;
  double a[3], b[3];
  int used = 0;
  for (int axis = 0; axis < 3; axis++) {
    double best = HUGE_VAL, second = HUGE_VAL;
    for (int side = -1; side <= 1; side += 2) {
      const int32_t next = node_neighbour(m->set, node, side * steps[axis]);
      if (next < 0 || !accepted[next]) continue;
      const double near = distance[next];
      if (near >= best) continue;
      best = near;
      second = HUGE_VAL;
      const int32_t after = node_neighbour(m->set, next, side * steps[axis]);
      if (after >= 0 && accepted[after]) {
        const double far = distance[after];
        if (far <= near) second = far;
      }
    }
    if (best == HUGE_VAL) continue;
    a[used] = (second < HUGE_VAL ? 1.5 : 1.0) * inverse;
    b[used] = (second < HUGE_VAL ? 2.0 * best - 0.5 * second : best) * inverse;
    used++;
  }
  /* drop the axis with the largest upwind value until the solution lies above all of them */
  for (; used > 0; used--) {
    double aa = 0, ab = 0, bb = -1;
    int largest = 0;
    for (int k = 0; k < used; k++) {
      aa += a[k] * a[k];
      ab += a[k] * b[k];
      bb += b[k] * b[k];
      if (b[k] / a[k] > b[largest] / a[largest]) largest = k;
    }
    const double root = ab * ab - aa * bb;
    if (root >= 0) {
      const double value = (ab + sqrt(root)) / aa;
      if (used == 1 || value >= b[largest] / a[largest]) return value;
    }
    a[largest] = a[used - 1];
    b[largest] = b[used - 1];
  }
  return HUGE_VAL;
}

/* Marches over the nodes `inside` from those whose `distance` (m) is finite. `accepted` is scratch of as many, zeroed.
 * Returns 0, or 1 when memory is short. */
int cathsim_march(const NodeSet* set, const uint8_t* inside, double spacing, uint8_t* accepted, double* distance) {
  const March march = {set, inside, accepted, distance, 1.0 / spacing};
  Heap heap = {0};
  int failed = 0;
  for (int32_t node = 0; node < set->count && !failed; node++)
    if (inside[node] && isfinite(distance[node])) failed = !push(&heap, (Entry){distance[node], node});
  while (heap.count > 0 && !failed) {
    const Entry top = pop(&heap);
    if (accepted[top.node] || top.value > distance[top.node]) continue;
    accepted[top.node] = 1;
    for (int axis = 0; axis < 3 && !failed; axis++) {
      for (int side = -1; side <= 1; side += 2) {
        const int32_t node = node_neighbour(set, top.node, side * steps[axis]);
        if (node < 0 || !inside[node] || accepted[node]) continue;
        const double value = solve(&march, node);
        if (value < distance[node]) {
          distance[node] = value;
          if (!push(&heap, (Entry){value, node})) failed = 1;
        }
      }
    }
  }
  free(heap.entries);
  return failed;
}

/* One layer outwards: each of `count` `open` nodes gets the mean of its 26 neighbours' values that are finite, as they
 * were before; it stays infinite where there is none. `values` has one for each node of the set. */
void cathsim_continue_outwards(const NodeSet* set, int32_t count, const int32_t* open, float* values, float* means) {
  for (int32_t i = 0; i < count; i++) {
    float total = 0, known = 0;
    for (int x = -1; x <= 1; x++) {
      for (int y = -1; y <= 1; y++) {
        for (int z = -1; z <= 1; z++) {
          if (!x && !y && !z) continue;
          const int32_t next = node_neighbour(set, open[i], x * NODE_X + y * NODE_Y + z * NODE_Z);
          if (next < 0 || !isfinite(values[next])) continue;
          total += values[next];
          known += 1;
        }
      }
    }
    means[i] = known > 0 ? total / known : HUGE_VALF;
  }
  for (int32_t i = 0; i < count; i++) values[open[i]] = means[i];
}
