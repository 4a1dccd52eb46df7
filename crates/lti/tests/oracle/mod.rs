//! Agreement with independent programs whose results are stored in `testdata/`.

mod reduction;
