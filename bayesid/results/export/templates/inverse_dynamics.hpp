// Joint torques of {{ found.name | plain }}, identified by {{ found.method | plain }} from the {{ found.channel }}, with their {{ "%g" | format(100 * level) }} % band.
// Written by bayesid. C++17, no dependencies. SI units: rad or m, N m or N; joints in the order
//   {{ robot.joint_names | join(", ") | plain }}
//
//   double q[{{ n }}], v[{{ n }}], a[{{ n }}], torque[{{ n }}], half[{{ n }}];
//   bayesid_model::inverse_dynamics(q, v, a, torque);      // rigid bodies, friction and what else acts inside the joints
//   bayesid_model::half_band(q, v, a, half);               // torque +- half holds the truth's mean with {{ "%g" | format(100 * level) }} %, joint by joint
//
// half is nan where the torque takes something that the data say nothing of{{ "" if covariance is not none else ", here everywhere: " ~ found.method ~ " has no covariance" }}.
// No function allocates, throws, or keeps anything. For a second robot in one program, say before including its file
//   #define BAYESID_NAMESPACE another_name
{% if found.unread %}
// Not in it, for their torque was not read: what acts inside {{ found.unread | join(", ") | plain }}.
{% endif %}
{% for spec in model.left_out %}
// Not in it, though in the model that was identified: {{ spec | plain }}.
{% endfor %}
#pragma once

#include <cmath>
#include <limits>

#ifndef BAYESID_NAMESPACE
#define BAYESID_NAMESPACE bayesid_model
#endif

namespace BAYESID_NAMESPACE {

constexpr int joints = {{ n }};
constexpr int parameters = {{ count }};  // {{ rank }} of rigid bodies, then those inside the joints
constexpr double quantile = {{ half }};  // of the normal law, of half the band
inline constexpr const char* joint_names[joints] = {
{%- for name in robot.joint_names %}{{ name | quoted }}{{ ", " if not loop.last }}{% endfor -%} };

namespace detail {

inline constexpr int order[joints] = {{ order | braces }};    // every parent before its children
inline constexpr int parent[joints] = {{ robot.parent | braces }};   // -1: the base
inline constexpr bool slides[joints] = {{ robot.prismatic | braces }};
inline constexpr double gravity[3] = {{ robot.gravity | braces }};
// Placement of each joint's frame at position zero in its parent's, rows one after the other; axis in its own frame.
inline constexpr double rotation[joints][9] = {{ robot.rotation.reshape(n, 9) | braces }};
inline constexpr double translation[joints][3] = {{ robot.translation | braces }};
inline constexpr double axis[joints][3] = {{ robot.axis | braces }};
// Mass, first moment and inertia (xx, xy, yy, xz, yz, zz) about its joint's frame of each link: links that have the identified base
// parameters, and move as the robot does; they need not be bodies that can exist.
inline constexpr double links[joints][10] = {{ links | braces }};

// Columns of the band: the joint whose link it belongs to, ten parameters of a unit of it.
inline constexpr int bodies = {{ rank }};
inline constexpr int body_joint[bodies] = {{ body_joint | braces }};
inline constexpr double body[bodies][10] = {{ body_ten | braces }};
{% if covariance is not none %}
{% if model.hidden.shape[1] %}
// Changes of the parameters that the data do not show: a torque that takes any of them is not known.
inline constexpr int changes = {{ model.hidden.shape[1] }};
inline constexpr double hidden[changes][parameters] = {{ model.hidden.T | braces }};
{% endif %}
inline constexpr double covariance[parameters][parameters] = {{ covariance | braces }};
{% endif %}

struct State {  // of a link, in its own axes: rotation to its parent, origin in it, spin, its rate, acceleration of the origin
    double r[9], p[3], w[3], dw[3], acc[3];
};

inline void cross(const double* a, const double* b, double* out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

inline void to_parent(const double* r, const double* x, double* out) {
    for (int i = 0; i < 3; ++i) out[i] = r[3 * i] * x[0] + r[3 * i + 1] * x[1] + r[3 * i + 2] * x[2];
}

inline void from_parent(const double* r, const double* x, double* out) {
    for (int i = 0; i < 3; ++i) out[i] = r[i] * x[0] + r[3 + i] * x[1] + r[6 + i] * x[2];
}

inline void forward(const double* q, const double* v, const double* a, State* state) {
    static constexpr double still[3] = {0.0, 0.0, 0.0};
    const double lifted[3] = {-gravity[0], -gravity[1], -gravity[2]};
    for (int i : order) {
        State& s = state[i];
        const double* d = axis[i];
        const double turn = slides[i] ? 0.0 : q[i], c = std::cos(turn), e = 1.0 - c, sine = std::sin(turn);
        const double own[9] = {c + e * d[0] * d[0], e * d[0] * d[1] - sine * d[2], e * d[0] * d[2] + sine * d[1],
                               e * d[1] * d[0] + sine * d[2], c + e * d[1] * d[1], e * d[1] * d[2] - sine * d[0],
                               e * d[2] * d[0] - sine * d[1], e * d[2] * d[1] + sine * d[0], c + e * d[2] * d[2]};
        for (int k = 0; k < 3; ++k) {
            const double* row = rotation[i] + 3 * k;
            for (int j = 0; j < 3; ++j) s.r[3 * k + j] = row[0] * own[j] + row[1] * own[3 + j] + row[2] * own[6 + j];
            s.p[k] = translation[i][k] + (slides[i] ? q[i] * (row[0] * d[0] + row[1] * d[1] + row[2] * d[2]) : 0.0);
        }
        const bool root = parent[i] < 0;
        const double* w = root ? still : state[parent[i]].w;
        const double* dw = root ? still : state[parent[i]].dw;
        const double* acc = root ? lifted : state[parent[i]].acc;
        double arm[3], bent[3], turned[3], moved[3];
        cross(w, s.p, arm);
        cross(w, arm, bent);
        cross(dw, s.p, turned);
        for (int k = 0; k < 3; ++k) moved[k] = acc[k] + turned[k] + bent[k];
        from_parent(s.r, w, s.w);
        from_parent(s.r, dw, s.dw);
        from_parent(s.r, moved, s.acc);
        const double along[3] = {v[i] * d[0], v[i] * d[1], v[i] * d[2]};
        double coriolis[3];
        cross(s.w, along, coriolis);
        for (int k = 0; k < 3; ++k) {
            if (slides[i]) {
                s.acc[k] += a[i] * d[k] + 2.0 * coriolis[k];
            } else {
                s.w[k] += along[k];
                s.dw[k] += a[i] * d[k] + coriolis[k];
            }
        }
    }
}

// Force and moment about its joint's origin that a body with these ten parameters takes.
inline void wrench(const State& s, const double* b, double* force, double* moment) {
    double arm[3], bent[3], turned[3], lever[3];
    cross(s.w, b + 1, arm);
    cross(s.w, arm, bent);
    cross(s.dw, b + 1, turned);
    for (int k = 0; k < 3; ++k) force[k] = b[0] * s.acc[k] + turned[k] + bent[k];
    const double inertia[9] = {b[4], b[5], b[7], b[5], b[6], b[8], b[7], b[8], b[9]};
    double spin[3], rate[3], gyro[3];
    to_parent(inertia, s.w, spin);
    to_parent(inertia, s.dw, rate);
    cross(s.w, spin, gyro);
    cross(b + 1, s.acc, lever);
    for (int k = 0; k < 3; ++k) moment[k] = rate[k] + gyro[k] + lever[k];
}

// Force and moment, moved to the parent's frame.
inline void carry(const State& s, double* force, double* moment) {
    double f[3], n[3], lever[3];
    to_parent(s.r, force, f);
    to_parent(s.r, moment, n);
    cross(s.p, f, lever);
    for (int k = 0; k < 3; ++k) {
        force[k] = f[k];
        moment[k] = n[k] + lever[k];
    }
}

inline double about(int i, const double* force, const double* moment) {
    const double* x = slides[i] ? force : moment;
    return axis[i][0] * x[0] + axis[i][1] * x[1] + axis[i][2] * x[2];
}

// Sign of a velocity; nearly at rest, where a joint may stick, a narrow ramp.
inline double direction(double v) {
    return v >= {{ ramp }} ? 1.0 : v <= -{{ ramp }} ? -1.0 : v / {{ ramp }};
}

inline double sign(double x) {
    return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : 0.0;
}

// Torques that move and carry the links.
inline void of_links(const State* state, double* torque) {
    double force[joints][3], moment[joints][3];
    for (int i = 0; i < joints; ++i) wrench(state[i], links[i], force[i], moment[i]);
    for (int k = joints - 1; k >= 0; --k) {
        const int i = order[k], up = parent[i];
        torque[i] = about(i, force[i], moment[i]);
        if (up < 0) continue;
        carry(state[i], force[i], moment[i]);
        for (int c = 0; c < 3; ++c) {
            force[up][c] += force[i][c];
            moment[up][c] += moment[i][c];
        }
    }
}

}  // namespace detail

// Torque of every joint [N m or N] at positions q, velocities v and accelerations a.
inline void inverse_dynamics(const double* q, const double* v, const double* a, double* torque) {
    using namespace detail;
    using std::abs; using std::cos; using std::exp; using std::sin;
    State state[joints];
    forward(q, v, a, state);
    of_links(state, torque);
{% if loaded %}
    double load[joints];
    for (int i = 0; i < joints; ++i) load[i] = torque[i];
{% endif %}
{% for law in model.laws %}
    {  // {{ law.spec | plain }}
        [[maybe_unused]] const double s_ = direction(v[{{ law.joint }}]){{ ", l_ = load[%d]" | format(law.joint) if law.per_load }};
        torque[{{ law.joint }}] += {{ law.torque | cpp(law.joint) }};
    }
{% endfor %}
}

// Half the {{ "%g" | format(100 * level) }} % band of every joint's torque [N m or N]: of the model's mean, not of the noise of a single reading.
inline void half_band([[maybe_unused]] const double* q, [[maybe_unused]] const double* v, [[maybe_unused]] const double* a,
                      double* half) {
{% if covariance is none %}
    for (int i = 0; i < joints; ++i) half[i] = std::numeric_limits<double>::quiet_NaN();
{% else %}
    using namespace detail;
    using std::abs; using std::cos; using std::exp; using std::sin;
    State state[joints];
    forward(q, v, a, state);
    double row[joints][parameters] = {};
    for (int c = 0; c < bodies; ++c) {
        double force[3], moment[3];
        wrench(state[body_joint[c]], body[c], force, moment);
        for (int i = body_joint[c]; i >= 0; i = parent[i]) {
            row[i][c] = about(i, force, moment);
            carry(state[i], force, moment);
        }
    }
{% if loaded %}
    double load[joints];
    of_links(state, load);
{% endif %}
{% for law in model.laws if law.per_load %}
    {  // {{ law.spec | plain }}, which multiplies what the links take
        const double s_ = direction(v[{{ law.joint }}]), l_ = load[{{ law.joint }}], more = {{ law.per_load | cpp(law.joint) }};
        for (int c = 0; c < bodies; ++c) row[{{ law.joint }}][c] *= 1.0 + more;
    }
{% endfor %}
{% for law in model.laws if law.derivatives %}
    {  // {{ law.spec | plain }}
        [[maybe_unused]] const double s_ = direction(v[{{ law.joint }}]){{ ", l_ = load[%d]" | format(law.joint) if law.per_load }};
{% for column, text in law.derivatives %}
        row[{{ law.joint }}][{{ column }}] = {{ text | cpp(law.joint) }};
{% endfor %}
    }
{% endfor %}
    for (int i = 0; i < joints; ++i) {
        double variance = 0.0;
        for (int k = 0; k < parameters; ++k) {
            double sum = 0.0;
            for (int j = 0; j < parameters; ++j) sum += covariance[k][j] * row[i][j];
            variance += row[i][k] * sum;
        }
        half[i] = quantile * std::sqrt(variance > 0.0 ? variance : 0.0);
{% if model.hidden.shape[1] %}
        double length = 0.0;
        for (double x : row[i]) length += x * x;
        for (const auto& change : hidden) {
            double taken = 0.0, among = 0.0;
            for (int k = 0; k < parameters; ++k) {
                taken += row[i][k] * change[k];
                among += abs(row[i][k] * change[k]);
            }
            if (abs(taken) > {{ share_of_change }} * among && abs(taken) > {{ share_of_row }} * std::sqrt(length))
                half[i] = std::numeric_limits<double>::quiet_NaN();
        }
{% endif %}
    }
{% endif %}
}

}  // namespace BAYESID_NAMESPACE

#undef BAYESID_NAMESPACE
