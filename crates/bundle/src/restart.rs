//! Paths beyond the length of a table: looked up again from where they have come to.
//!
//! In: the state of a path of a glued space where the table ends. Out: the fan with which it goes on, if the table's
//! cameras are there. Of a space whose domain is in the region of cameras, a short table has paths of any length.
//!
//! A part's points are as far off as the table promises, as seen from where the part begins; its first direction is
//! off by what the tangent at the end of the part before is. Along a path these add up.

use crate::{Fan, LookupError, Table};
use glam::DVec3;

impl Table {
    /// Tells whether paths can be looked up again where the table ends: in glued spaces whose paths the cover knows.
    pub fn restarts(&self) -> bool {
        let gluing = self.space.manifold().gluing_below();
        gluing.is_some_and(|gluing| !gluing.has_portals() && !gluing.has_mirrors())
    }

    /// Looks up where the path that has come to the point `u` of the domain with the tangent `v` goes on: in the fan of all
    /// paths from there, in this direction (standard frame, unit).
    ///
    /// # Errors
    /// `u` is not in the camera region, or the patches there are damaged.
    pub fn restarted(&self, u: DVec3, v: DVec3) -> Result<(Fan, DVec3), LookupError> {
        let fan = self.fan(u)?;
        let direction = self.space.manifold().local_frame(u).direction(v);
        Ok((fan, direction.normalize_or_zero()))
    }
}
