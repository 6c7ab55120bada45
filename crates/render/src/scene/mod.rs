//! What stands in the manifold: scene files, meshes, materials and the pictures they name.
//!
//! In: paths. Out: [`SceneFile`] and [`Mesh`], checked, with warnings for what was mended.

mod cutting;
mod exponential_map;
mod file;
#[cfg(feature = "formats")]
mod formats;
#[cfg(feature = "gltf")]
mod gltf_mesh;
#[cfg(feature = "gltf")]
mod gltf_source;
mod lens;
mod material;
mod mesh;
#[cfg(feature = "formats")]
mod mtl;
mod named_table;
#[cfg(feature = "formats")]
mod obj;
#[cfg(feature = "formats")]
mod obj_mesh;
mod packed_numbers;
mod placement;
#[cfg(feature = "formats")]
mod ply_mesh;
#[cfg(feature = "formats")]
mod polygon;
#[cfg(feature = "formats")]
mod smoothing;
mod trajectory;

pub use cutting::Points;
pub use file::{
    CameraEntry, CameraPosition, LightEntry, ObjectEntry, Placement, SceneFile, SkyEntry,
};
pub use lens::{CameraProjection, Lens, Stereo, StereoLayout, USUAL_FOV};
pub use material::Material;
pub use material::{Mapping, OpacityMap, Texture, TextureMap, Wrap};
pub use mesh::Mesh;
pub use mesh::pack as pack_meshes;
#[cfg(feature = "formats")]
pub(super) use mesh::{materials_are_exact, put_materials, take_materials};
pub(super) use packed_numbers::take_chunk;
pub use placement::placed_once;
pub use placement::{Cuts, pack_cuts, pack_points, read_cuts, read_points};
pub(super) use placement::{Placed, place};
pub use trajectory::{CameraMotion, Formulas};
pub use trajectory::{Course, Trajectory};
pub use trajectory::{KeyPose, PoseFile};
