/* Values at the nodes of a regular lattice, in blocks of 8 x 8 x 8 nodes (lattice/node_blocks.py).
 *
 * A stored block also holds the nodes next to it: any 3 x 3 x 3 nodes lie within the block of their middle. Blocks far
 * from the vessel share block 0, which holds one constant. */
#ifndef CATHSIM_LATTICE_H_
#define CATHSIM_LATTICE_H_

#include <stddef.h>
#include <stdint.h>

/* From a node to the next along each axis, within a stored block. */
enum { NODE_X = 100, NODE_Y = 10, NODE_Z = 1, NODES = 1000 };

typedef struct {
  int size[3];          /* nodes along x, y, z */
  int blocks[3];        /* blocks along x, y, z */
  const int32_t* table; /* number of each block, z runs fastest */
  const float* nodes;   /* NODES of each stored block */
} Lattice;

/* Where node (i, j, k) of the lattice stands, with its neighbours around it. */
static inline const float* lattice_node(const Lattice* l, int i, int j, int k) {
  const int32_t block = l->table[((size_t)(i >> 3) * l->blocks[1] + (j >> 3)) * l->blocks[2] + (k >> 3)];
  return l->nodes + (size_t)block * NODES + ((i & 7) + 1) * NODE_X + ((j & 7) + 1) * NODE_Y + (k & 7) + 1;
}

/* Linear interpolation in the cell above node `index`, `t` from it, 0 to 1 along each axis. */
static inline double lattice_interpolate(const Lattice* l, const int index[3], const double t[3]) {
  const float* c = lattice_node(l, index[0], index[1], index[2]);
  const double c00 = c[0] + t[2] * (c[NODE_Z] - c[0]);
  const double c01 = c[NODE_Y] + t[2] * (c[NODE_Y + NODE_Z] - c[NODE_Y]);
  const double c10 = c[NODE_X] + t[2] * (c[NODE_X + NODE_Z] - c[NODE_X]);
  const double c11 = c[NODE_X + NODE_Y] + t[2] * (c[NODE_X + NODE_Y + NODE_Z] - c[NODE_X + NODE_Y]);
  const double c0 = c00 + t[1] * (c01 - c00), c1 = c10 + t[1] * (c11 - c10);
  return c0 + t[0] * (c1 - c0);
}

/* Some nodes of a lattice, numbered from 0 (lattice/node_set.py). */
typedef struct {
  int32_t count;
  const int32_t* numbers;   /* a lattice in blocks with each node's number, -1 at all others */
  const int64_t* positions; /* where each node stands in it */
} NodeSet;

/* Number of the neighbour a step away, -1 where that is none of the set; a step is a sum of NODE_X, NODE_Y and NODE_Z,
 * each at most once forwards or backwards. */
static inline int32_t node_neighbour(const NodeSet* set, int32_t node, int step) {
  return set->numbers[set->positions[node] + step];
}

#endif
