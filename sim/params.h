// What an artist can set about the simulation itself. Each parameter is declared once, in fields(); see declare.h.
// Stiffness and damping are given for the reference step h0 = 1/60 s, and keep their meaning at any other
// (passes/stiffness.h).
#pragma once

#include <string>

#include "sim/declare.h"

namespace strandbake {

// Paper, section 3.4 and Algorithms 3, 4, 5.
struct LocalShapeParams {
  double stiffness = 0.5;  // S_L
  int iterations = 3;
  int method = 1;
  bool reaction = true;
};
template <class V>
void fields(V& v, LocalShapeParams& p) {
  v("stiffness", p.stiffness, between(0, 1).keyed(), "1",
    "How strongly bends and curls return, per iteration of a 1/60 s step. 0 switches the pass off, 1 is rigid.");
  v("iterations", p.iterations, between(0, 1000), "1",
    "Sweeps of the constraint in a substep. 0 switches the pass off.");
  v("method", p.method, between(1, 4), "1",
    "How the local frames are updated. 1: exactly, root to tip. 2: from the frames of the previous iteration. 3: "
    "rest frames turned with the head. 4: exactly, for the whole strand before each iteration.");
  v("reaction", p.reaction, Switch{}, "",
    "true: a bend that returns pushes back on the hair before it, so that more substeps make hair calmer and more "
    "exact. "
    "false: as in the paper. Method 3 needs none.");
}

// Paper, section 3.3.
struct GlobalShapeParams {
  double stiffness = 0.1;  // S_G at the root
  double range = 0.3;
  double fade = 1;
};
template <class V>
void fields(V& v, GlobalShapeParams& p) {
  v("stiffness", p.stiffness, between(0, 1).keyed(), "1",
    "How strongly a vertex returns to its place on the head, per 1/60 s step. 0 switches the pass off, 1 is rigid.");
  v("range", p.range, between(0, 1), "1",
    "The part of a strand that the pass acts on, as a share of its length from the root.");
  v("fade", p.fade, between(0, 1), "1",
    "How much of the stiffness is gone at the end of the range. 0: none, then a hard end. 1: all of it, linearly.");
}

// Directly (passes/direct_length.h), or as the paper's Algorithm 1 line 9.
struct LengthParams {
  bool direct = true;
  int iterations = 0;  // where not direct

  static LengthParams iterated(int iterations) { return {false, iterations}; }
};
template <class V>
void fields(V& v, LengthParams& p) {
  v("direct", p.direct, Switch{}, "",
    "true: all segments of a strand are solved for at once; hair that is held by its root does not stretch at all.");
  v("iterations", p.iterations, between(0, 1000), "1",
    "Instead: sweeps of the paper's constraint in a substep, even edges then odd ones. 0 lets lengths go.");
}

// The rod (passes/rod_bend.h, passes/rod_stretch.h). The defaults are human hair.
struct RodParams {
  double young = 4e9;
  double poisson = 0.3;
  double shear = 0;
  double radius = 35e-6;
  double density = 1300;
  double stiffness = 1;
  int iterations = 1;
  bool exact_lengths = true;
};
template <class V>
void fields(V& v, RodParams& p) {
  v("young", p.young, between(1e5, 1e12), "Pa",
    "Young's modulus: how hard hair is to bend. That of human hair is 3e9 to 5e9.");
  v("poisson", p.poisson, between(-0.99, 0.5), "1", "Poisson's ratio, which makes the shear modulus of Young's.");
  v("shear", p.shear, at_least(0), "Pa",
    "Shear modulus: how hard hair is to twist, from 0.01 to 100 times young. 0: from young and poisson.");
  v("radius", p.radius, between(1e-6, 0.01), "m", "Of a hair. Fine human hair has 25e-6, medium 35e-6, coarse 45e-6.");
  v("density", p.density, between(10, 30000), "kg/m^3", "Of hair.");
  v("stiffness", p.stiffness, between(1e-6, 1e6), "1",
    "A factor for bending and twist alike: above 1 for hair with spray in it, below for wet or styled to be soft.");
  v("iterations", p.iterations, between(1, 100), "1",
    "Newton iterations in a substep. One is enough but where hair whips about with one substep a frame.");
  v("exact_lengths", p.exact_lengths, Switch{}, "",
    "true: hair does not stretch at all. false: as far as Young's modulus has it.");
}

struct RegionParams {
  bool simulate = true;
  bool sag_free = false;
  double damping = 0.1;
  double drag = 1;
  std::string method = "shape";
  LocalShapeParams local;
  GlobalShapeParams global;
  LengthParams lengths;
  RodParams rod;

  bool is_rod() const { return method == "rod"; }
};
template <class V>
void fields(V& v, RegionParams& p) {
  v("simulate", p.simulate, Switch{}, "", "false: the region's hair just rides on the head, at next to no cost.");
  v("sag_free", p.sag_free, Switch{}, "",
    "true: the groom is in balance as it was made, under the gravity and on the head of the first frame; where that "
    "balance is not stable, as of long soft hair that stands up, it falls all the same. false: it sags under its "
    "weight.");
  v("damping", p.damping, between(0, 1).keyed(), "1", "The share of its velocity that a vertex loses in 1/60 s.");
  v("drag", p.drag, at_least(0).keyed(), "1/s",
    "Acceleration by the wind, per m/s of wind across the strand. 0 lets no wind in.");
  v("method", p.method, one_of({"shape", "rod"}), "",
    "\"shape\": bends by local and lengths by lengths, as in the paper. \"rod\": bends, twist and lengths of an "
    "elastic rod; local and lengths have no part in it then, global has.");
  v("local", p.local, "Local shape: keeps bends and curls.");
  v("global", p.global, "Global shape: keeps hair near its place on the head.");
  v("lengths", p.lengths, "Edge lengths: \"direct\", or {iterations = 2} as in the paper.");
  v("rod", p.rod, "The rod: what hair is made of.");
}

struct ForceParams {
  Eigen::Vector3d gravity{0, -9.81, 0};
};
template <class V>
void fields(V& v, ForceParams& p) {
  v("gravity", p.gravity, any_number().keyed(), "m/s^2", "Acceleration of every free vertex.");
}

struct WindParams {
  Eigen::Vector3d velocity{0, 0, 0};
  double gust = 0;
  double period = 1;
};
template <class V>
void fields(V& v, WindParams& p) {
  v("velocity", p.velocity, any_number().keyed(), "m/s", "Mean velocity of the air. Zero switches the wind off.");
  v("gust", p.gust, at_least(0).keyed(), "1",
    "How far the wind strays from its mean, along it and across it, as a share of its speed. A function of time and "
    "strand alone.");
  v("period", p.period, between(0.001, 1e6), "s", "Time between two gusts.");
}

}  // namespace strandbake
