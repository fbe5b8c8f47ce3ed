//! Two readings jointly.

#[path = "../examples/neighbouring_beams.rs"]
mod neighbouring_beams;

use neighbouring_beams::compare;

/// Where objects stand in both beams, the joint model knows it: more than half a nat. Where they don't, the control,
/// it gains nothing.
#[test]
fn the_joint_model_gains_where_the_beams_depend_on_each_other() {
    let dependent = compare(0.9).unwrap();
    assert!(dependent.joint < dependent.product - 0.5, "{} {}", dependent.joint, dependent.product);
    let independent = compare(0.0).unwrap();
    assert!(independent.joint > independent.product - 0.05, "{} {}", independent.joint, independent.product);
}
