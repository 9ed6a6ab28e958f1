/* Fast marching: distance inside a lumen from seeds, second order in the spacing where two known nodes line up.
 *
 * Solves |grad T| = 1 with upwind differences, accepting nodes in the order of their distance (Sethian 1996). The
 * lumen's nodes are numbered; each knows its neighbours' numbers. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

typedef struct {
  double value;
  int32_t node;
} Entry;

typedef struct {
  Entry* entries;
  int64_t count, capacity;
} Heap;

static int push(Heap* h, double value, int32_t node) {
  if (h->count == h->capacity) {
    int64_t capacity = h->capacity ? 2 * h->capacity : 4096;
    Entry* grown = realloc(h->entries, capacity * sizeof(Entry));
    if (!grown) return 0;
    h->entries = grown;
    h->capacity = capacity;
  }
  int64_t i = h->count++;
  while (i > 0 && h->entries[(i - 1) / 2].value > value) {
    h->entries[i] = h->entries[(i - 1) / 2];
    i = (i - 1) / 2;
  }
  h->entries[i] = (Entry){value, node};
  return 1;
}

static Entry pop(Heap* h) {
  Entry top = h->entries[0], last = h->entries[--h->count];
  int64_t i = 0;
  for (;;) {
    int64_t child = 2 * i + 1;
    if (child >= h->count) break;
    if (child + 1 < h->count && h->entries[child + 1].value < h->entries[child].value) child++;
    if (h->entries[child].value >= last.value) break;
    h->entries[i] = h->entries[child];
    i = child;
  }
  if (h->count > 0) h->entries[i] = last;
  return top;
}

enum { NEIGHBOURS = 6 }; /* of a node: before and after along x, then y, then z; -1 where the lumen ends */

/* The distance at a node from its accepted neighbours. Along each axis the upwind difference is a T - b, with a in
 * 1/spacing; the squares add up to 1. */
static double solve(const int32_t* neighbours, double inverse, const uint8_t* accepted, const double* distance,
                    int32_t node) {
  double a[3], b[3];
  int used = 0;
  for (int axis = 0; axis < 3; axis++) {
    double best = HUGE_VAL, second = HUGE_VAL;
    for (int side = 0; side < 2; side++) {
      const int32_t next = neighbours[(size_t)NEIGHBOURS * node + 2 * axis + side];
      if (next < 0 || !accepted[next]) continue;
      const double near = distance[next];
      if (near >= best) continue;
      best = near;
      second = HUGE_VAL;
      const int32_t after = neighbours[(size_t)NEIGHBOURS * next + 2 * axis + side];
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

/* Marches over `count` nodes from those whose `distance` (m) is finite. `neighbours` is count x 6, `accepted` scratch
 * of that size, zeroed. Returns 0, or 1 when memory is short. */
int cathsim_march(int32_t count, const int32_t* neighbours, double spacing, uint8_t* accepted, double* distance) {
  Heap heap = {0};
  int failed = 0;
  for (int32_t node = 0; node < count && !failed; node++)
    if (isfinite(distance[node])) failed = !push(&heap, distance[node], node);
  while (heap.count > 0 && !failed) {
    const Entry top = pop(&heap);
    if (accepted[top.node] || top.value > distance[top.node]) continue;
    accepted[top.node] = 1;
    for (int k = 0; k < NEIGHBOURS && !failed; k++) {
      const int32_t node = neighbours[(size_t)NEIGHBOURS * top.node + k];
      if (node < 0 || accepted[node]) continue;
      const double value = solve(neighbours, 1.0 / spacing, accepted, distance, node);
      if (value < distance[node]) {
        distance[node] = value;
        if (!push(&heap, value, node)) failed = 1;
      }
    }
  }
  free(heap.entries);
  return failed;
}
