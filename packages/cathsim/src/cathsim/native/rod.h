/* Two coaxial devices, a wire in a catheter, as one chain of links: what each joint and link is made of follows how far
 * one device covers the other and how each is turned. */
#ifndef CATHSIM_ROD_H_
#define CATHSIM_ROD_H_

#include <mujoco/mujoco.h>

enum { ROD_WIRE = 0, ROD_CATHETER = 1, ROD_DEVICES = 2 };

/* A device: tables over the distance from its tip, constant beyond the last node. */
typedef struct {
  int count;               /* nodes */
  double spacing;          /* between nodes, m */
  const double* bending;   /* EI, N m^2 */
  const double* torsion;   /* GJ, N m^2 */
  const double* curvature; /* of the unloaded device, count x 2, 1/m: about its x and y */
  double length;           /* from hub to tip, m */
  double radius;           /* m */
  double friction;         /* on the wall */
  double mass;             /* of a metre, kg */
  double relaxation;       /* time in which its bending relaxes, s */
} Device;

/* A joint stands for the bending of a cell of the chain; integrals over that cell. */
typedef struct {
  double flexibility;        /* integral of ds / EI, 1/(N m) */
  double rest[ROD_DEVICES][2]; /* bend at rest by each device that is turned by 0, rad */
  double mixed[2];           /* coupling of both rest curvatures, N m: complex, wire's times the catheter's conjugate */
  double own;                /* energy of both rest curvatures that are turned apart by 90 degrees, N m */
  double relaxation;         /* s */
  double bending_length;     /* length of the part whose bending counts, m */
} Cell;

typedef struct {
  mjModel* model;            /* of this chain alone: its arrays are rewritten */
  const Device* device[ROD_DEVICES]; /* NULL: absent */
  int joints;                /* of two hinges each */
  int links;
  int first_joint;           /* their numbers in the model: hinges follow each other, so do geoms and bodies */
  int first_geom;
  int first_body;
  int rotation;              /* coordinate that turns the whole chain about its axis; -1: there is none */
  int rigid;                 /* devices do not twist */
  const double* from_end;    /* distance of each joint from the chain's end, m */
  const double* before;      /* half of the link proximal to it, m */
  const double* after;       /* half of the link distal to it, m */
  const double* lengths;     /* of the links, m */
  const double* inverse_weight; /* body_invweight0 of a chain of the wire alone, then of a covered one: 2 x links x 2 */
  Cell* cells;               /* one a joint */
  double* twist[ROD_DEVICES];   /* how far each device is turned at each joint, in the joint's frame, rad */
  double* workspace;         /* for 8 numbers a joint */
  double lead_from, lead_to; /* how far the wire is ahead of the catheter, m, at the control step's begin and end */
  double hub_from[ROD_DEVICES], hub_to[ROD_DEVICES]; /* angles of the hubs, rad, likewise */
  double lead;               /* of the moment, m */
  double hub[ROD_DEVICES];   /* rad */
  double shown;              /* the lead that `cells` and the model's arrays are of; NaN: none */
  double feeder_force[ROD_DEVICES]; /* beyond the chain's own feeder: what pushes this device alone, N */
  double hub_torque[ROD_DEVICES];   /* N m */
} Rod;

/* Brings the model to a share (0 to 1) of the control step, for the bends that `data` has. */
void rod_update(Rod* rod, const mjData* data, double share);

/* Energy of bending (N m) that the chain would have at another lead, its bends and twists as they are. */
double rod_energy(const Rod* rod, const mjData* data, double lead);

/* Enters the force that pushes each device alone along the other, and the torques at the hubs. */
void rod_report(Rod* rod, const mjData* data);

/* Lets the devices' twist come to rest at fixed bends; returns how many iterations that took. */
int rod_untwist(Rod* rod, const mjData* data, int most, double tolerance);

#endif
