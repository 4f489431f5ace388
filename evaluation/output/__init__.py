"""Figures, pictures, pages and point clouds. Import the modules: matplotlib and plotly load only where they are used."""
