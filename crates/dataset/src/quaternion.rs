/// The heading (rad) of a body with the orientation (qx, qy, qz, qw): that of its x axis, seen from above.
///
/// # Errors
/// The quaternion's length, where that isn't 1 (to 1 %).
pub fn heading([qx, qy, qz, qw]: [f64; 4]) -> Result<f64, f64> {
    let length = qw.hypot(qx).hypot(qy.hypot(qz));
    if (0.99..=1.01).contains(&length) {
        Ok((2.0 * (qw * qz + qx * qy)).atan2(qw * qw + qx * qx - qy * qy - qz * qz))
    } else {
        Err(length)
    }
}
